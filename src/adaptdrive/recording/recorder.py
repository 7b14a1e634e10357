"""The recorder service in the control process: gather, pack, hand over, never wait."""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeGuard

import msgspec

from adaptdrive.recording.batches import (
    Batch,
    CommandRow,
    EventRow,
    Header,
    TickTable,
    command_row,
    event_row,
    sensor_row,
    slow_row,
)
from adaptdrive.recording.black_box import BlackBox
from adaptdrive.recording.delivery import Delivery
from adaptdrive.recording.session import Dropped
from adaptdrive.runtime.hub import Hub, Subscription
from adaptdrive.runtime.reports import (
    CommandReport,
    DriveReport,
    Event,
    LoadReport,
    Report,
    SensorSample,
    Severity,
    TickReport,
)

EVENT_KIND = "recording"
"""Kind of the events about the recorder itself."""

_SLICE = 50
"""Reports packed before the event loop gets its turn: about 0.1 ms."""

_EVENTS_HELD = 1000
"""Events kept for a recorder process that has fallen behind."""


@dataclass(frozen=True, slots=True)
class WritePace:
    """Intervals and time-outs of the recorder's writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes that may wait to be written: about 40 s; then batches are dropped.
        close_s: Longest time that the end of the recording takes, in four parts: the record of a
            trip, the recorder process, another one in its place, and what then is left; and that
            the events after it take.
        trip_s: How long the record of a trip goes on after it.
        keep_s: Longest time that an event waits for its record before it is published.
        start_thread: What a thread that writes does first.
    """

    flush_s: float = 0.25
    backlog_bytes: int = 1 << 20
    close_s: float = 8.0
    trip_s: float = 10.0
    keep_s: float = 0.2
    start_thread: Callable[[], None] = lambda: None


DEFAULT_PACE = WritePace()


@dataclass(frozen=True, slots=True)
class Clocks:
    """The clocks of the recorder.

    Attributes:
        utc: Wall clock.
        monotonic: Monotonic clock in seconds, the one of the reports.
    """

    utc: Callable[[], datetime]
    monotonic: Callable[[], float]


@dataclass(frozen=True, slots=True)
class Feed:
    """Queues of the recorder, one for each kind, so that ticks never push out an event."""

    ticks: Subscription
    slow: Subscription
    sensors: Subscription
    events: Subscription

    @classmethod
    def of(cls, hub: Hub, flush_s: float) -> Feed:
        """Subscribe to a hub, with room for four flushes of 120 ticks a second."""
        reports = max(1000, round(4 * 120 * flush_s))
        return cls(
            ticks=hub.subscribe(TickReport, size=reports),
            slow=hub.subscribe(LoadReport, size=reports),
            sensors=hub.subscribe(SensorSample, DriveReport, size=reports),
            events=hub.subscribe(Event, CommandReport, size=_EVENTS_HELD),
        )


class Recorder:
    """Records one session until cancelled.

    Ticks and slow steps go out every `flush_s`, an event as soon as it is heard of. Trouble with
    the recording is reported and changes nothing else.

    Attributes:
        complete: False once the end of the session could not be recorded.
    """

    def __init__(
        self,
        header: Header,
        feed: Feed,
        report: Callable[[Event], None],
        clocks: Clocks,
        pace: WritePace = DEFAULT_PACE,
    ) -> None:
        """Prepare to record.

        Args:
            header: Where, and the facts that go with it.
            feed: What to record.
            report: Takes the recorder's own events, such as the hub's `publish`.
            clocks: The clocks.
            pace: How often and how patiently.
        """
        self.complete = True
        self._feed = feed
        self._publish = report
        self._clocks = clocks
        self._pace = pace
        self._delivery = Delivery(header, pace.backlog_bytes, self._report, pace.start_thread)
        self._black_box = BlackBox(
            header,
            self._report,
            clocks.monotonic,
            after_s=pace.trip_s,
            start_thread=pace.start_thread,
        )
        self._waiting: deque[TickReport] = deque()
        self._ticks = TickTable()
        self._slow: list[dict[str, Any]] = []
        self._sensors: list[dict[str, float]] = []
        self._events: deque[EventRow] = deque()
        self._commands: deque[CommandRow] = deque()
        self._numbers = itertools.count(1)
        self._lost = Dropped()
        self._reported_loss = Dropped()
        self._stalled = False
        self._open = False
        self._closed = False
        self._last_tick = 0

    @property
    def failing(self) -> bool:
        """True while what is to be recorded is not written."""
        return self._stalled or self._delivery.failing

    async def run(self, begin: asyncio.Event | None = None) -> None:
        """Record until cancelled, then write what is left and close the session.

        Args:
            begin: Nothing touches the disk before this is set; None to begin at once.
        """
        if begin is not None:
            await begin.wait()
        self._open = True
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._delivery.run(), name="recorder-delivery")
                group.create_task(self._feed_for_ever(), name="recorder-feed")
                group.create_task(self._black_box.run(), name="recorder-black-box")
        finally:
            await self._finish()

    async def keep(self) -> None:
        """Wait until each event and command published so far is in a file.

        It waits at most `keep_s`, and not at all for a disk that has just been slower than that.
        Before the session begins and after its end there is nothing to wait for.
        """
        self._note(self._feed.events.drain())
        if self._open:
            if self._events or self._commands:
                self._send()
            await self._delivery.kept(self._pace.keep_s)

    async def add_late(self) -> None:
        """Add the events and commands since the close to the session; `run` must have ended."""
        self._note(self._feed.events.drain())
        if not (self._closed and self.complete and (self._events or self._commands)):
            return
        self._send(urgent=True, last=True)
        lost = await self._delivery.finish_again(self._pace.close_s)
        self.complete = lost == Dropped()

    async def _feed_for_ever(self) -> None:
        deadline = self._clocks.monotonic() + self._pace.flush_s
        while True:
            self._note(await self._events_until(deadline))
            if self._clocks.monotonic() >= deadline:
                deadline = self._clocks.monotonic() + self._pace.flush_s
                await self._gather()
            self._send()

    async def _finish(self) -> None:
        part_s = self._pace.close_s / 4.0
        await self._send_rest()
        # after the last tick, and before the end: its report belongs to the session
        await self._black_box.finish(part_s)
        await self._send_rest()
        self._send(urgent=True, last=True)  # it has no rows: they are written before the close
        self._open, self._closed = False, True
        lost = await self._delivery.finish(self._dropped(), part_s)
        self.complete = lost == Dropped()

    async def _send_rest(self) -> None:
        await self._gather()
        self._note(self._feed.events.drain())  # those that came meanwhile, too
        self._send(urgent=True)

    async def _events_until(self, deadline: float) -> Iterable[Report]:
        try:
            async with asyncio.timeout(max(0.0, deadline - self._clocks.monotonic())):
                return await self._feed.events.take()
        except TimeoutError:
            return ()

    def _note(self, reports: Iterable[Report]) -> None:
        utc, now_s = self._clocks.utc(), self._clocks.monotonic()
        for report in reports:
            if isinstance(report, Event):
                self._events.append(event_row(report, utc, now_s, next(self._numbers)))
            elif isinstance(report, CommandReport):
                self._commands.append(command_row(report, utc, now_s, next(self._numbers)))
        for held in (self._events, self._commands):
            while len(held) > _EVENTS_HELD:
                held.popleft()
                self._lose(events=1)

    async def _gather(self) -> None:
        """Turn queued reports into columns and rows; cancelled half-way, it loses none."""
        self._slow += [slow_row(r) for r in self._feed.slow.drain() if isinstance(r, LoadReport)]
        self._sensors += map(sensor_row, filter(_has_sensors, self._feed.sensors.drain()))
        self._waiting += (r for r in self._feed.ticks.drain() if isinstance(r, TickReport))
        while self._waiting:
            count = min(_SLICE, len(self._waiting))
            reports = [self._waiting.popleft() for _ in range(count)]
            self._ticks.extend(reports)
            self._last_tick = reports[-1].measurement.tick
            await asyncio.sleep(0)

    def _send(self, *, urgent: bool = False, last: bool = False) -> None:
        batch = self._batch(last=last)
        if batch.empty:
            return
        self._ticks, self._slow, self._sensors = TickTable(), [], []
        self._black_box.directory = self._delivery.directory
        self._black_box.keep(batch)
        if self._delivery.offer(batch, urgent=urgent):
            self._note_sent(batch)
        else:
            self._note_refused(batch)
            self._send_events()

    def _send_events(self) -> None:
        """Hand over the events of a refused batch, for which there still is room."""
        few = msgspec.structs.replace(
            self._batch(last=False), tick_rows=0, ticks={}, slow=[], sensors=[]
        )
        if not few.empty and self._delivery.offer(few):
            self._events.clear()
            self._commands.clear()

    def _batch(self, *, last: bool) -> Batch:
        return Batch(
            tick_rows=self._ticks.rows,
            ticks=self._ticks.packed(),
            slow=self._slow,
            events=list(self._events),
            dropped=self._dropped(),
            last=last,
            utc_offset_s=self._clocks.utc().timestamp() - self._clocks.monotonic(),
            sensors=self._sensors,
            commands=list(self._commands),
        )

    def _note_sent(self, batch: Batch) -> None:
        self._events.clear()
        self._commands.clear()
        # events still fit while ticks are refused: the stall lasts until ticks fit again
        self._stalled = self._stalled and self._delivery.full
        if batch.dropped != self._reported_loss and not self._stalled:
            self._reported_loss = batch.dropped
            self._report(Severity.WARNING, f"not recorded so far: {batch.dropped}")

    def _note_refused(self, batch: Batch) -> None:
        self._lose(ticks=batch.tick_rows, slow=len(batch.slow))
        if not self._stalled:
            self._report(Severity.WARNING, f"{self._hindrance}; ticks are lost")
        self._stalled = True

    @property
    def _hindrance(self) -> str:
        """Reason why ticks are not written, in words."""
        if self._delivery.failing:
            return "no more ticks can wait until recording goes on"
        return "the recorder process has stalled"

    def _lose(self, ticks: int = 0, slow: int = 0, events: int = 0) -> None:
        self._lost += Dropped(ticks, slow, events)

    def _dropped(self) -> Dropped:
        """Everything lost so far: in the queues, and on the way to the recorder process."""
        feed = self._feed
        return self._lost + Dropped(feed.ticks.dropped, feed.slow.dropped, feed.events.dropped)

    def _report(self, severity: Severity, detail: str) -> None:
        self._publish(self._event(severity, detail))

    def _event(self, severity: Severity, detail: str) -> Event:
        return Event(EVENT_KIND, severity, detail, self._last_tick)


def _has_sensors(report: Report) -> TypeGuard[SensorSample | DriveReport]:
    return isinstance(report, SensorSample) or (
        isinstance(report, DriveReport) and bool(report.sensors)
    )
