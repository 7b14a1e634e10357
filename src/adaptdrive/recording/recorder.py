"""The recorder service in the control process: gather, pack, hand over, never wait."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from adaptdrive.recording.batches import (
    Batch,
    EventRow,
    Header,
    TickTable,
    event_row,
    slow_row,
)
from adaptdrive.recording.session import Dropped, NewSession
from adaptdrive.recording.writer_process import WriterProcess
from adaptdrive.runtime.hub import Hub, Subscription
from adaptdrive.runtime.reports import Event, LoadReport, Report, Severity, TickReport

EVENT_KIND = "recording"
"""Kind of the events by which the recorder speaks of itself."""

_SLICE = 50
"""Reports packed before the event loop gets its turn: about 0.1 ms."""

_EVENTS_HELD = 1000
"""Events kept for a recorder process that has fallen behind."""


@dataclass(frozen=True, slots=True)
class Pace:
    """How often and how patiently the recorder writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes that may wait for the recorder process; then batches are dropped.
        close_s: Longest wait for the recorder process at the end.
    """

    flush_s: float = 2.0
    backlog_bytes: int = 1 << 20
    close_s: float = 30.0


DEFAULT_PACE = Pace()


@dataclass(frozen=True, slots=True)
class Feed:
    """What is recorded: a queue for each kind, so that ticks never push out an event."""

    ticks: Subscription
    slow: Subscription
    events: Subscription

    @classmethod
    def of(cls, hub: Hub, flush_s: float) -> Feed:
        """Subscribe to a hub, with room for four flushes of 120 ticks a second."""
        reports = max(1000, round(4 * 120 * flush_s))
        return cls(
            ticks=hub.subscribe(TickReport, size=reports),
            slow=hub.subscribe(LoadReport, size=reports),
            events=hub.subscribe(Event, size=_EVENTS_HELD),
        )


class Recorder:
    """Records one session until cancelled.

    Ticks and slow steps go out every `flush_s`, an event as soon as it is heard of. Trouble with
    the recording is told through `report` and changes nothing else.
    """

    def __init__(
        self,
        session: NewSession,
        feed: Feed,
        report: Callable[[Event], None],
        utc_now: Callable[[], datetime],
        pace: Pace = DEFAULT_PACE,
    ) -> None:
        """Prepare to record.

        Args:
            session: Where, and the facts that go with it.
            feed: What to record.
            report: Takes the recorder's own events, such as the hub's `publish`.
            utc_now: Wall clock, for the time of events.
            pace: How often and how patiently.
        """
        self._session = session
        self._feed = feed
        self._tell = report
        self._utc_now = utc_now
        self._pace = pace
        self._waiting: deque[TickReport] = deque()
        self._ticks = TickTable()
        self._slow: list[dict[str, Any]] = []
        self._events: deque[EventRow] = deque()
        self._lost = Dropped()
        self._recorded_loss = Dropped()
        self._stalled = False
        self._last_tick = 0

    async def run(self) -> None:
        """Record until cancelled, then write what is left and close the session.

        Returns early, after reporting it, when the recorder process ends by itself.
        """
        try:
            writer = await WriterProcess.start(self._session.directory, self._pace.backlog_bytes)
        except OSError as problem:
            self._report(Severity.ALARM, f"cannot record: {problem}")
            return
        writer.send(Header(self._session.info, self._session.config_text))
        try:
            cause = await self._feed_until_end(writer)
        except asyncio.CancelledError:
            await self._finish(writer)
            raise
        self._report(Severity.ALARM, f"recording has stopped, control goes on: {cause}")

    async def _feed_until_end(self, writer: WriterProcess) -> str:
        async with asyncio.TaskGroup() as group:
            feeding = group.create_task(self._feed_for_ever(writer), name="recorder-feed")
            cause = await writer.ended()
            feeding.cancel()
        return cause

    async def _feed_for_ever(self, writer: WriterProcess) -> None:
        clock = asyncio.get_running_loop().time
        deadline = clock() + self._pace.flush_s
        while True:
            self._note(await self._events_until(deadline))
            if clock() >= deadline:
                deadline = clock() + self._pace.flush_s
                await self._gather()
            self._send(writer)

    async def _finish(self, writer: WriterProcess) -> None:
        self._note(self._feed.events.drain())
        await self._gather()
        self._send(writer, last=True)
        problem = await writer.close(self._pace.close_s)
        if problem is not None:
            self._report(Severity.ALARM, f"trouble at the end of the session: {problem}")

    async def _events_until(self, deadline: float) -> Iterable[Report]:
        try:
            async with asyncio.timeout_at(deadline):
                return await self._feed.events.take()
        except TimeoutError:
            return ()

    def _note(self, reports: Iterable[Report]) -> None:
        now = self._utc_now()
        for report in reports:
            # Our own events would be news of the recording to the recording.
            if isinstance(report, Event) and report.kind != EVENT_KIND:
                self._events.append(event_row(report, now))
        while len(self._events) > _EVENTS_HELD:
            self._events.popleft()
            self._lose(events=1)

    async def _gather(self) -> None:
        """Turn queued reports into columns and rows; cancelled half-way, it loses none."""
        self._slow += [slow_row(r) for r in self._feed.slow.drain() if isinstance(r, LoadReport)]
        self._waiting += (r for r in self._feed.ticks.drain() if isinstance(r, TickReport))
        while self._waiting:
            count = min(_SLICE, len(self._waiting))
            reports = [self._waiting.popleft() for _ in range(count)]
            self._ticks.extend(reports)
            self._last_tick = reports[-1].measurement.tick
            await asyncio.sleep(0)

    def _send(self, writer: WriterProcess, *, last: bool = False) -> None:
        batch = self._batch(last=last)
        if batch.empty or not writer.listens:
            return
        self._ticks, self._slow = TickTable(), []
        if writer.send(batch, urgent=last):
            self._note_sent(batch)
        else:
            self._note_refused(batch)

    def _batch(self, *, last: bool) -> Batch:
        dropped, events = self._dropped(), list(self._events)
        if dropped != self._recorded_loss:
            loss = self._event(Severity.WARNING, f"not recorded so far: {dropped}")
            events.append(event_row(loss, self._utc_now()))
        return Batch(
            tick_rows=self._ticks.rows,
            ticks=self._ticks.packed(),
            slow=self._slow,
            events=events,
            dropped=dropped,
            last=last,
        )

    def _note_sent(self, batch: Batch) -> None:
        if batch.dropped != self._recorded_loss:
            self._report(Severity.WARNING, f"not recorded so far: {batch.dropped}")
        self._events.clear()
        self._recorded_loss = batch.dropped
        self._stalled = False

    def _note_refused(self, batch: Batch) -> None:
        self._lose(ticks=batch.tick_rows, slow=len(batch.slow))
        if not self._stalled:
            self._report(Severity.WARNING, "the recorder process has stalled; ticks are lost")
        self._stalled = True

    def _lose(self, ticks: int = 0, slow: int = 0, events: int = 0) -> None:
        lost = self._lost
        self._lost = Dropped(lost.ticks + ticks, lost.slow + slow, lost.events + events)

    def _dropped(self) -> Dropped:
        """Everything lost so far: in the queues, and on the way to the recorder process."""
        feed, lost = self._feed, self._lost
        return Dropped(
            ticks=feed.ticks.dropped + lost.ticks,
            slow=feed.slow.dropped + lost.slow,
            events=feed.events.dropped + lost.events,
        )

    def _report(self, severity: Severity, detail: str) -> None:
        self._tell(self._event(severity, detail))

    def _event(self, severity: Severity, detail: str) -> Event:
        return Event(EVENT_KIND, severity, detail, self._last_tick)
