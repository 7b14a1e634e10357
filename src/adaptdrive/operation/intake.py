"""Takes the runtime's reports as they come, stamps them, and lays them out for sending.

It never waits for the broker. A report carries the time of its arrival from here on, however
long it then waits, so that nothing old is ever sent as new.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import assert_never

from adaptdrive.operation.board import Mailbox, StateBoard
from adaptdrive.operation.clock import WallClock
from adaptdrive.operation.history import History
from adaptdrive.operation.messages import (
    Payload,
    drive_message,
    encode,
    event_message,
    histogram_message,
    load_message,
)
from adaptdrive.operation.outbox import Outbox
from adaptdrive.operation.profile import Output
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import (
    CommandReport,
    DriveReport,
    Event,
    LoadReport,
    Report,
    SensorSample,
    Severity,
    StateReport,
    TickReport,
)

REPORTS_HELD = 256
LOAD_MESSAGES_HELD = 16


class Intake:
    """Receiver of reports.

    Attributes:
        board: The present state.
        outbox: Events that the broker has not taken yet.
        load: Slow periods not sent yet.
        drive: The newest word of the fast loop, unless sent.
        histograms: The newest histograms of the fast loop, unless sent.
    """

    def __init__(  # noqa: PLR0913 - it joins the parts of the service
        self,
        hub: Hub,
        board: StateBoard,
        outbox: Outbox,
        history: History,
        *,
        wall: WallClock,
        output: Output,
    ) -> None:
        self.board = board
        self.outbox = outbox
        self.load: Mailbox[Payload] = Mailbox(LOAD_MESSAGES_HELD)
        self.drive: Mailbox[Payload] = Mailbox(1)
        self.histograms: Mailbox[Payload] = Mailbox(1)
        self._wall = wall
        self._output = output
        self._hub = hub
        self._history = history
        self._discarded = 0
        self._reports = hub.subscribe(
            StateReport, LoadReport, DriveReport, Event, size=REPORTS_HELD
        )

    async def run(self) -> None:
        """Take reports until cancelled."""
        while True:
            reports = await self._reports.take()
            for report in reports:
                self._lay_out(report)
            await self._pass_on([one for one in reports if isinstance(one, Event)])

    def report(self, kind: str, severity: Severity, detail: str) -> None:
        """Publish an event of the operators' side to the log, the recording and the broker."""
        self._hub.publish(Event(kind, severity, detail, -1))

    def report_discarded(self) -> None:
        """Report how many events were discarded because none could be sent, if any."""
        discarded = self.outbox.dropped + self._reports.dropped - self._discarded
        if discarded:
            self._discarded += discarded
            self.report(
                "outbox",
                Severity.WARNING,
                f"{discarded} events or other reports were discarded: at most {self.outbox.limit} "
                "events wait for the broker, and the oldest go first",
            )

    def catch_up(self) -> None:
        """Take what has arrived, without waiting for more."""
        for report in self._reports.drain():
            self._lay_out(report)
            if isinstance(report, Event):
                self.outbox.put(self._event_body(report))

    def history_pages(self) -> Iterator[Payload]:
        """Yield the payloads that answer a request for the last hour."""
        return self._history.pages(self._wall())

    def forget_telemetry(self) -> None:
        """Throw away telemetry that was not sent in time."""
        self.load.drain()
        self.drive.drain()
        self.histograms.drain()

    async def _pass_on(self, events: Sequence[Event]) -> None:
        """Queue events for the broker once they are recorded, or as this daemon ends."""
        bodies = [self._event_body(event) for event in events]
        try:
            if bodies:
                await self._hub.kept()
        finally:
            for body in bodies:
                self.outbox.put(body)

    def _event_body(self, event: Event) -> bytes:
        return encode(event_message(event, self._wall()))

    def _lay_out(self, report: Report) -> None:
        match report:
            case StateReport():
                self.board.show(report)
            case LoadReport():
                message = load_message(report, self._wall(), self._output)
                self.load.put(message)
                self._history.add(message)
            case DriveReport():
                message = drive_message(report, self._wall(), self._output)
                self.drive.put(message)
                self._history.add_reading(message)
                self.histograms.put(histogram_message(report, self._wall()))
            case Event() | TickReport() | SensorSample() | CommandReport():
                pass
            case _:
                assert_never(report)
