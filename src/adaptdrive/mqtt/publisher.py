"""Takes the runtime's reports as they come, and holds what is to be published.

It never waits for the broker. A report carries the time of its arrival from here on, however
long it then waits, so that nothing old is ever sent as new.

For a page that is opened late it keeps the slow steps of the last hour and the readings of 300 s.
Of the steps in each 12 s at most two are kept: those with the lowest and the highest output, so
that a plot shows every overshoot. Readings are kept as they come, ten a second.
"""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from operator import itemgetter

import msgspec

from adaptdrive.mqtt import contract
from adaptdrive.runtime import reports
from adaptdrive.safety.trips import Trip, TripKind, remedy
from adaptdrive.util.trends import HealthReport

# Reports to publish: the present state, and queues of what was not published yet.


class StateBoard:
    """The state as operators see it; its time moves only when something else does."""

    def __init__(
        self,
        wall: Callable[[], datetime],
        profile: contract.Profile,
        last_trip: contract.LastTrip | None,
    ) -> None:
        """Begin without a report.

        Args:
            wall: Wall clock in UTC.
            profile: Name, unit and limits of the drive.
            last_trip: The last trip of an earlier run, None before the first.
        """
        self._wall = wall
        self._profile = profile
        self._report: reports.StateReport | None = None
        now = wall()
        self._standing = contract.Standing(now, last_trip, contract.Synchronisation.UNKNOWN, now)
        self._changed = asyncio.Event()

    @property
    def state(self) -> reports.State | None:
        """State of the state machine, None before the first report."""
        return self._report.state if self._report else None

    @property
    def trip_kind(self) -> TripKind | None:
        """Kind of the latched trip, None when not tripped."""
        return self._report.trip_kind if self._report else None

    @property
    def shutting_down(self) -> bool:
        """True while the daemon ends."""
        return self._report is not None and self._report.shutting_down

    @property
    def message(self) -> contract.Payload | None:
        """Payload to publish, None before the first report."""
        if self._report is None:
            return None
        return contract.state_message(self._report, self._standing, self._profile)

    def show(self, report: reports.StateReport) -> None:
        """Take a report of the runtime."""
        known, self._report = self._report, report
        if report == known:
            return
        self._note_change()
        now = self._standing.time
        if known is None or report.state is not known.state:
            self._standing = replace(self._standing, since=now)
        if report.trip is not None and (known is None or report.trip != known.trip):
            kind = report.trip_kind
            trip = contract.LastTrip(now, kind, report.trip, remedy(kind))
            self._standing = replace(self._standing, last_trip=trip)

    def show_clock(self, clock: contract.Synchronisation) -> None:
        """Store whether the wall clock is synchronised."""
        if clock is not self._standing.clock:
            self._standing = replace(self._standing, clock=clock)
            self._note_change()

    async def change(self) -> None:
        """Wait until something is new since the last wait."""
        await self._changed.wait()
        self._changed.clear()

    def _note_change(self) -> None:
        self._standing = replace(self._standing, time=self._wall())
        self._changed.set()


LIMIT = 10_000


class Outbox(reports.Queue[bytes]):
    """A queue of payloads, each of which stays until the broker has it."""

    def __init__(self, recalled: Iterable[bytes], note_sent: Callable[[], None]) -> None:
        """Begin with what an earlier run could not send.

        Args:
            recalled: Payloads, the oldest first.
            note_sent: Has the log know that the broker has the oldest one.
        """
        super().__init__(LIMIT)
        self._note_sent = note_sent
        for body in recalled:
            self.put(body)

    def sent(self, body: bytes) -> None:
        """Remove the oldest payload, which the broker has acknowledged, unless it went."""
        if self._items and self._items[0] is body:
            self._remove_oldest()
            self._note_sent()


# Takes the runtime's reports as they come, stamps them, and lays them out for sending.

SPAN_S = 3600.0
BUCKET_S = 12.0
PAGE_ROWS = 50
READING_SPAN_S = 300.0
PAGE_READINGS = 500
KEYS = (
    *("time", "k", "reference", "output", "boost_reference_V", "applied_V"),
    *("controller", "mode", "accepted", "reason", "estimates"),
)
"""Keys of a row: those of `telemetry/load` that a plot needs."""

_ROWS = 2 * math.ceil(SPAN_S / BUCKET_S)
_READINGS = math.ceil(READING_SPAN_S * 10.0)


_Row = tuple[float, float, bytes]
"""When a slow step came, monotonic and in s; its output, infinite where it is none; its payload."""


class History:
    """The slow steps of the last hour, at most two for each 12 s, and the readings of 300 s."""

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self._monotonic = monotonic
        self._rows: deque[_Row] = deque(maxlen=_ROWS)
        self._readings: deque[bytes] = deque(maxlen=_READINGS)
        self._asked: tuple[float | None, float | None] = (None, None)

    def add(self, message: contract.Payload) -> None:
        """Take in a payload of `telemetry/load`."""
        self._asked = (message["reference"], message["boost_reference_V"])
        output, now_s = message["output"], self._monotonic()
        body = contract.encode({key: message[key] for key in KEYS})
        bucket = [(now_s, output if math.isfinite(output) else math.inf, body)]
        while self._rows and self._rows[-1][0] // BUCKET_S == now_s // BUCKET_S:
            bucket.insert(0, self._rows.pop())
        self._rows.extend(_extremes(bucket))

    def add_reading(self, message: contract.Payload) -> None:
        """Take in a payload of `telemetry/drive`; nothing is asked for while the bridge is off."""
        time_s = round(message["time"].timestamp(), 2)
        asked = self._asked if message["command"].bridge else (None, None)
        reading = (time_s, message["output"], message["boost_voltage_V"], *asked)
        self._readings.append(msgspec.json.encode(reading))

    def pages(self, time: datetime) -> Iterator[contract.Payload]:
        """Yield the payloads of an answer, the newest rows first.

        Args:
            time: Time of the answer, the same in each of its pages.
        """
        oldest_s = self._monotonic() - SPAN_S
        rows = [body for taken_s, _, body in self._rows if taken_s >= oldest_s]
        readings = list(self._readings)
        count = max(1, math.ceil(len(rows) / PAGE_ROWS), math.ceil(len(readings) / PAGE_READINGS))
        for page in range(1, count + 1):
            yield {
                "time": time,
                "page": page,
                "pages": count,
                "rows": _part(rows, page, PAGE_ROWS),
                "readings": _part(readings, page, PAGE_READINGS),
            }


def _part(bodies: list[bytes], page: int, size: int) -> list[msgspec.Raw]:
    """Return the bodies of a page; the first page has the newest."""
    end = max(0, len(bodies) - (page - 1) * size)
    return [msgspec.Raw(body) for body in bodies[max(0, end - size) : end]]


def _extremes(rows: list[_Row]) -> list[_Row]:
    """Return the rows with the lowest and the highest output, in the order of their times."""
    if len(rows) <= 2:
        return rows
    output = itemgetter(1)
    kept = {min(rows, key=output)[0], max(rows, key=output)[0]}
    return [row for row in rows if row[0] in kept][:2]


REPORTS_HELD = 256
LOAD_MESSAGES_HELD = 16


@dataclass
class Intake:
    """Receiver of reports.

    Attributes:
        hub: Where they come from.
        board: The present state.
        outbox: Events that the broker has not taken yet.
        history: Steps and readings for a page that is opened late.
        wall: Wall clock.
        output: Name and unit of the regulated quantity.
        load: Slow periods not sent yet.
        drive: The newest report of the fast loop, unless sent.
        histograms: The newest histograms of the fast loop, unless sent.
        health: The newest health of the load, unless sent; it is sent again to each broker.
    """

    hub: reports.Hub
    board: StateBoard
    outbox: Outbox
    history: History
    wall: Callable[[], datetime]
    output: contract.Output

    def __post_init__(self) -> None:
        self.load: reports.Queue[contract.Payload] = reports.Queue(LOAD_MESSAGES_HELD)
        self.drive: reports.Queue[contract.Payload] = reports.Queue(1)
        self.histograms: reports.Queue[contract.Payload] = reports.Queue(1)
        self.health: reports.Queue[contract.Payload] = reports.Queue(1)
        self._condition: contract.Payload | None = None
        self._discarded = 0
        self._unkept: list[bytes] = []
        kinds = reports.StateReport, reports.LoadReport, reports.DriveReport, reports.Event
        self._reports = self.hub.subscribe(*kinds, HealthReport, size=REPORTS_HELD)

    async def run(self) -> None:
        """Take reports until cancelled; events are for the broker once they are recorded."""
        while True:
            self._lay_out(await self._reports.take())
            try:
                if self._unkept:
                    await self.hub.kept()
            finally:
                self._release()

    def report(self, kind: str, severity: reports.Severity, detail: str) -> None:
        """Publish an event of the operators' side to stderr, the log and the broker."""
        self.hub.publish(reports.Event(kind, severity, detail, -1))

    def report_other(self, cause: Trip) -> None:
        """Report another client that has this daemon's name, or publishes as its drive."""
        alarm = reports.Severity.ALARM
        self.hub.publish(reports.Event("broker", alarm, cause.text, -1, cause.kind))

    def report_no_commands(self, detail: str) -> None:
        """Report that no command arrives, not even a stop."""
        text = (
            f"no commands: {detail}; no command arrives over MQTT, no disable either: give this "
            "daemon's user the right to read its commands"
        )
        self.report("broker", reports.Severity.ALARM, text)

    def report_discarded(self) -> None:
        """Report how many events were discarded because none could be sent, if any."""
        discarded = self.outbox.dropped + self._reports.dropped - self._discarded
        if discarded:
            self._discarded += discarded
            self.report(
                "outbox",
                reports.Severity.WARNING,
                f"{discarded} events or other reports were discarded: at most {self.outbox.limit} "
                "events wait for the broker, and the oldest go first",
            )

    def catch_up(self) -> None:
        """Take what has arrived, without waiting for more: the daemon ends."""
        self._lay_out(self._reports.drain())
        self._release()

    def forget_telemetry(self) -> None:
        """Throw away telemetry that was not sent in time."""
        for box in (self.load, self.drive, self.histograms):
            box.drain()
        if self._condition is not None:  # a broker that was started again has none
            self.health.put(self._condition)

    def _lay_out(self, taken: Sequence[reports.Report]) -> None:
        for report in taken:
            time = self.wall()
            match report:
                case reports.StateReport():
                    self.board.show(report)
                case reports.LoadReport():
                    message = contract.load_message(report, time, self.output)
                    self.load.put(message)
                    self.history.add(message)
                case reports.DriveReport():
                    trip = self.board.trip_kind
                    message = contract.drive_message(report, time, self.output, trip)
                    self.drive.put(message)
                    self.history.add_reading(message)
                    self.histograms.put(contract.histogram_message(report, time))
                case HealthReport():
                    self._condition = contract.health_message(report)
                    self.health.put(self._condition)
                case reports.Event():
                    self._unkept.append(contract.encode(contract.event_message(report, time)))

    def _release(self) -> None:
        for body in self._unkept:
            self.outbox.put(body)
        self._unkept.clear()
