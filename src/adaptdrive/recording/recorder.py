"""The recorder service in the control process: gather, hand over to the log, never wait."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import sys
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeGuard

import msgspec

from adaptdrive.recording.archive_run import run_archiver
from adaptdrive.recording.frames import Kind
from adaptdrive.recording.log import LARGEST_BACKLOG_BYTES, Log
from adaptdrive.recording.log_writer import SYNC, LogNews
from adaptdrive.recording.memory import TRIP, Recalled
from adaptdrive.recording.records import (
    Header,
    TickTable,
    command_row,
    event_row,
    sensor_row,
    slow_row,
)
from adaptdrive.recording.session import Dropped, NewSession, create_session, session_of
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

STOPPED = "recording has stopped, control continues"
UNBEGUN = "nothing is recorded, control continues"

_SLICE = 50
"""Reports packed before the event loop gets its turn: about 0.1 ms."""

_EVENTS_HELD = 1000
_COUNTED_S = 10.0
"""Longest time between two records: the next run takes the time since the last from the clock."""

_RETRY_S = 60.0
"""Pause of the archiver after a failure."""


@dataclass(frozen=True, slots=True)
class Place:
    """Folders of the recorder.

    Attributes:
        log: Folder of the log.
        sessions: Folder of all sessions, None where none is recorded.
    """

    log: Path
    sessions: Path | None


@dataclass(frozen=True, slots=True)
class WritePace:
    """Intervals and time-outs of the recorder's writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes of rows that may wait to be written; then the oldest are dropped.
        close_s: Longest time that the end of the recording takes, in two parts: the log, and the
            archiver.
        trip_s: Time after a trip that belongs to its record.
        keep_s: Longest time that an event waits for its record before it is published.
        start_thread: What a thread that writes does first.
    """

    flush_s: float = 0.25
    backlog_bytes: int = LARGEST_BACKLOG_BYTES
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

    def both(self) -> tuple[float, float]:
        """Return monotonic and wall time, in seconds."""
        return self.monotonic(), self.utc().timestamp()


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

    def __init__(  # noqa: PLR0913, PLR0917 - it joins the feed to the log
        self,
        place: Place,
        header: Header,
        feed: Feed,
        report: Callable[[Event], None],
        clocks: Clocks,
        pace: WritePace = DEFAULT_PACE,
        recalled: Recalled = Recalled(),  # noqa: B008 - frozen
    ) -> None:
        """Prepare to record.

        Args:
            place: Folders.
            header: Facts about the session.
            feed: What to record.
            report: Takes the recorder's own events, such as the hub's `publish`.
            clocks: The clocks.
            pace: How often and how patiently.
            recalled: What an earlier run has left in the log.
        """
        self.complete = True
        self._place = place
        self._header = _placed(header, place)
        self._feed = feed
        self._publish = report
        self._clocks = clocks
        self._pace = pace
        self._log = Log(
            place.log,
            self._header,
            recalled,
            clocks.both,
            hear=self._hear,
            begin_rows=self._make_session,
            start_thread=pace.start_thread,
            backlog_bytes=pace.backlog_bytes,
        )
        self._directory: Path | None = None
        self._waiting: deque[TickReport] = deque()
        self._numbers = itertools.count(1)
        self._reported_loss = self._overflow = Dropped()
        self._stalled = False
        self._last_tick = 0
        self._counted_s = clocks.monotonic()
        self._archive_due = asyncio.Event()

    @property
    def failing(self) -> bool:
        """True while what is to be recorded is not written."""
        return self._stalled or self._log.failing

    def note(self, kind: Kind, payload: bytes) -> None:
        """Hand over a record that the next run reads; returns at once.

        Args:
            kind: Its kind.
            payload: Its contents.
        """
        self._log.append(kind, payload)

    async def run(self, begin: asyncio.Event | None = None) -> None:
        """Record until cancelled, then write what is left and close the session.

        Args:
            begin: No session is made before this is set; None to begin at once.
        """
        try:
            self._log.start()
        except RuntimeError as problem:
            self._report(Severity.ALARM, f"{UNBEGUN}: {problem}")
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._feed_for_ever(begin), name="recorder-feed")
                if self._place.sessions is not None:
                    group.create_task(self._archive_for_ever(begin), name="recorder-archive")
        finally:
            await self._finish()

    async def keep(self) -> None:
        """Wait until the disk keeps each event and command published so far.

        It waits at most `keep_s`, and not at all for a disk that has just been slower than that.
        """
        await self.kept(self._pace.keep_s)

    async def kept(self, patience_s: float) -> None:
        """Do the same with a patience, for what was noted as well."""
        self._note(self._feed.events.drain())
        await self._log.kept(patience_s)

    # -- from the feed to the log ----------------------------------------------------------------

    async def _feed_for_ever(self, begin: asyncio.Event | None) -> None:
        deadline = self._clocks.monotonic() + self._pace.flush_s
        begun = False
        while True:
            if not begun and (begin is None or begin.is_set()):
                begun = True
                if self._place.sessions is not None:
                    self._log.let_rows_in()
            self._note(await self._events_until(deadline))
            if self._clocks.monotonic() >= deadline:
                deadline = self._clocks.monotonic() + self._pace.flush_s
                await self._gather()
                self._count()

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
                event = event_row(report, utc, now_s, next(self._numbers))
                self._log.append(Kind.EVENT, msgspec.msgpack.encode(event))
                if event.kind == TRIP and self._place.sessions is not None:
                    loop = asyncio.get_running_loop()
                    loop.call_later(self._pace.trip_s + 0.1, self._archive_due.set)
            elif isinstance(report, CommandReport):
                command = command_row(report, utc, now_s, next(self._numbers))
                self._log.append(Kind.COMMAND, msgspec.msgpack.encode(command))

    async def _gather(self) -> None:
        """Turn queued reports into columns and rows; cancelled half-way, it loses none."""
        if self._place.sessions is None:
            for queue in (self._feed.slow, self._feed.sensors, self._feed.ticks):
                queue.drain()
            return
        slow = [slow_row(r) for r in self._feed.slow.drain() if isinstance(r, LoadReport)]
        self._append_rows(Kind.SLOW, slow)
        sensors = map(sensor_row, filter(_has_sensors, self._feed.sensors.drain()))
        self._append_rows(Kind.SENSORS, list(sensors))
        self._waiting += (r for r in self._feed.ticks.drain() if isinstance(r, TickReport))
        while self._waiting:
            await self._append_ticks()

    async def _append_ticks(self) -> None:
        """Append a table of ticks; one that is cancelled half-way appends what it has."""
        ticks = TickTable()
        try:
            while self._waiting and ticks.rows < _EVENTS_HELD:
                reports = [self._waiting.popleft() for _ in range(min(_SLICE, len(self._waiting)))]
                ticks.extend(reports)
                self._last_tick = reports[-1].measurement.tick
                await asyncio.sleep(0)
        finally:
            packed = msgspec.msgpack.encode(ticks.packed())
            self._log.append(Kind.TICKS, packed, ticks.rows)

    def _append_rows(self, kind: Kind, rows: Sequence[dict[str, Any]]) -> None:
        if rows:
            self._log.append(kind, msgspec.msgpack.encode(rows), len(rows))

    def _count(self) -> None:
        """Report what was dropped, once that has ended, and have the log say so."""
        overflow, dropped = self._log.dropped, self._dropped()
        stalled = overflow != self._overflow or (self._stalled and self._log.behind)
        self._overflow = overflow
        if stalled and not self._stalled:
            why = "the disk has stalled"
            if self._log.failing:
                why = "no more ticks can wait until recording continues"
            self._report(Severity.WARNING, f"{why}; ticks are lost")
        self._stalled = stalled
        new = dropped != self._reported_loss and not stalled
        if new:
            self._reported_loss = dropped
            self._report(Severity.WARNING, f"not recorded so far: {dropped}")
        now_s = self._clocks.monotonic()
        if new or now_s - self._counted_s >= _COUNTED_S:
            self._counted_s = now_s
            self._log.append(Kind.DROPPED, msgspec.msgpack.encode(dropped))

    def _dropped(self) -> Dropped:
        """Everything lost so far: in the queues, and on the way to the disk."""
        feed = self._feed
        queued = Dropped(feed.ticks.dropped, feed.slow.dropped, feed.events.dropped)
        return self._log.dropped + queued

    # -- from the log to the session -------------------------------------------------------------

    def _make_session(self) -> None:
        """Make the folder of the session, in the thread of the log.

        Raises:
            OSError: It cannot be made.
        """
        if self._directory is None and (sessions := self._place.sessions) is not None:
            info = self._header.info
            found = session_of(sessions, info)
            new = NewSession(sessions, info, self._header.config_text)
            self._directory = found or create_session(new)

    async def _archive_for_ever(self, begin: asyncio.Event | None) -> None:
        """Run the archiver: at the start, at each new segment, after each trip."""
        if begin is not None:
            await begin.wait()
        said = ""
        while True:
            problem = await self._archived()
            if problem and problem != said:
                self._report(Severity.ALARM, f"sessions are not written: {problem}")
            said = problem
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_RETRY_S if problem else None):
                    await self._archive_due.wait()
            self._archive_due.clear()

    async def _archived(self, *words: str) -> str:
        """Run the archiver once; why it failed, empty where it did not."""
        log, sessions = str(self._place.log), str(self._place.sessions)
        command = [sys.executable, "-P", "-m", "adaptdrive.recording.archiver"]
        words = log, sessions, str(self._pace.trip_s), *words
        return await run_archiver([*command, *words], self._report, self._pace.start_thread)

    async def _finish(self) -> None:
        part_s = self._pace.close_s / 2.0
        await self._gather()
        self._note(self._feed.events.drain())
        self._count()
        self._log.append(Kind.DROPPED, msgspec.msgpack.encode(self._dropped()))
        self._log.append(Kind.END, b"")
        recorded = self._place.sessions is not None
        written = await self._log.close(part_s)
        self.complete = not recorded or (written and self._directory is not None)
        if not self.complete:
            why = "; ".join(filter(None, self._log.problems.values())) or "the disk does not answer"
            self._report(Severity.ALARM, f"the end of the session is not recorded: {why}")
        elif recorded:
            await self._close_session(part_s)

    async def _close_session(self, patience_s: float) -> None:
        problem = "the disk is slow"
        if self._log.closed:
            problem = f"it takes longer than {patience_s:g} s"
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience_s):
                    problem = await self._archived("--no-figure")
        if problem:
            detail = f"the archiver, or the next start, completes the session's files: {problem}"
            self._report(Severity.WARNING, detail)

    # -- news of the log ---------------------------------------------------------------------------

    def _hear(self, outcome: LogNews) -> None:
        for what, problem in outcome.problems.items():
            self._hear_problem(what, problem)
        if outcome.part > 1:
            self._archive_due.set()

    def _hear_problem(self, what: str, problem: str) -> None:
        if what == SYNC:
            if problem:
                self._report(Severity.WARNING, f"a power cut may take what is written: {problem}")
            return
        stopped = STOPPED if self._directory is not None else UNBEGUN
        if problem:
            self._report(Severity.ALARM, f"{stopped}: {problem}")
        elif not self._log.failing:
            self._report(Severity.INFO, "recording continues")

    def _report(self, severity: Severity, detail: str) -> None:
        self._publish(Event(EVENT_KIND, severity, detail, self._last_tick))


def _placed(header: Header, place: Place) -> Header:
    """Return the facts with the folders, each seen from the other: both may be moved together."""
    if place.sessions is None:
        return header
    log, sessions = place.log, place.sessions
    try:
        seen = _seen_from(sessions, log)
        seen.encode()
    except UnicodeEncodeError:
        seen = ""  # then a reader has to wait for the archiver
    info = msgspec.structs.replace(header.info, log=seen)
    return msgspec.structs.replace(header, info=info, sessions=_seen_from(log.parent, sessions))


def _seen_from(folder: Path, other: Path) -> str:
    """Return the path of a folder from another one, which is its own where they are far apart."""
    if other.parent == folder:
        return other.name
    return f"../{other.name}" if other.parent == folder.parent else str(other)


def _has_sensors(report: Report) -> TypeGuard[SensorSample | DriveReport]:
    return isinstance(report, SensorSample) or (
        isinstance(report, DriveReport) and bool(report.sensors)
    )
