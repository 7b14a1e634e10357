"""The recorder service in the control process: gather, hand over to the log, never wait."""

import asyncio
import contextlib
import itertools
import os
from collections import deque
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from adaptdrive.recording import archiver, log_files, records, session
from adaptdrive.recording.log import SYNC, Clock, Log
from adaptdrive.runtime import reports
from adaptdrive.util.trends import HealthReport

STOPPED = "recording has stopped, control continues"
UNBEGUN = "nothing is recorded, control continues"

_SLICE = 50
"""Reports packed before the event loop gets its turn: about 0.1 ms."""

_EVENTS_HELD = 1000
_RATE_Hz = 4 * 120
"""Ticks for which queues have room between two flushes."""

_COUNTED_S = 10.0
"""Longest time between two records: the next run takes the time since the last from the clock."""

_RETRY_S = 60.0
"""Pause of the archiver after a failure."""


class Recorder:
    """Records one session until cancelled.

    Ticks and slow steps go out every `flush_s`, an event as soon as it comes. Trouble with
    the recording is reported and changes nothing else.

    Attributes:
        complete: False once the end of a session that has begun could not be recorded.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - it joins the feed to the log
        self,
        log: Path,
        sessions: Path | None,
        header: records.Header,
        hub: reports.Hub,
        clock: Clock,
        pace: records.Pace = records.Pace(),  # noqa: B008 - frozen
        recalled: log_files.Recalled = log_files.Recalled(),  # noqa: B008 - frozen
    ) -> None:
        """Prepare to record.

        Args:
            log: Folder of the log.
            sessions: Folder of all sessions, None where none is recorded.
            header: Facts about the session.
            hub: Where what is recorded comes from, and the recorder's own events go; a queue for
                each kind, so that ticks never push out an event.
            clock: Returns monotonic time, as the reports have it, and wall time, in seconds.
            pace: How often and how patiently.
            recalled: What an earlier run has left in the log.
        """
        self.complete = True
        self._place = log, sessions
        self._header = header = with_folders(header, log, sessions)
        held = max(1000, round(_RATE_Hz * pace.flush_s))
        self._ticks = hub.subscribe(reports.TickReport, size=held)
        self._slow = hub.subscribe(reports.LoadReport, size=held)
        self._sensors = hub.subscribe(reports.SensorSample, reports.DriveReport, size=held)
        self._events = hub.subscribe(reports.Event, reports.CommandReport, size=_EVENTS_HELD)
        self._publish, self._clock, self._pace = hub.publish, clock, pace
        self._log = Log(
            log,
            header,
            recalled,
            clock,
            pace,
            on_problem=self._on_problem,
            on_segment=lambda part: self._due.set() if part > 1 else None,
            begin_rows=self._make_session,
        )
        self._directory: Path | None = None
        self._due = asyncio.Event()
        self._begun = self._stalled = False
        self._waiting: deque[reports.TickReport] = deque()
        self._numbers = itertools.count(1)
        self._reported_loss = self._overflow = session.Dropped()
        self._last_tick = 0
        self._counted_s, _ = clock()

    @property
    def failing(self) -> bool:
        """True while what is to be recorded is not written."""
        return self._stalled or self._log.failing

    def note(self, kind: records.Kind, payload: bytes) -> None:
        """Hand over a record that the next run reads; returns at once.

        Args:
            kind: Its kind.
            payload: Its contents.
        """
        self._log.append(kind, payload)

    def session_name(self) -> str | None:
        """Return the name of the folder of the session, None while there is none."""
        return None if self._directory is None else self._directory.name

    async def run(self, begin: asyncio.Event | None = None) -> None:
        """Record until cancelled, then write what is left and close the session.

        Args:
            begin: No session is made before this is set; None to begin at once.
        """
        try:
            self._log.start()
        except RuntimeError as problem:
            self._report(reports.Severity.ALARM, f"{UNBEGUN}: {problem}")
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._feed_for_ever(), name="recorder-feed")
                group.create_task(self._archive(begin), name="recorder-archive")
        finally:
            await self._finish()

    async def kept(self, patience_s: float | None = None) -> None:
        """Wait until the disk keeps each event, command and note so far.

        It does not wait at all for a disk that has just been slower than that.

        Args:
            patience_s: Longest wait, None for `keep_s`.
        """
        self._note(self._events.drain())
        await self._log.kept(self._pace.keep_s if patience_s is None else patience_s)

    def _make_session(self) -> None:
        """Make the folder of the session where there is none, in the thread of the log."""
        _, sessions = self._place
        if sessions is not None and self._directory is None:
            info, text = self._header.info, self._header.config_text
            found = session.session_of(sessions, info)
            self._directory = found or session.create_session(sessions, info, text)

    async def _archive(self, begin: asyncio.Event | None) -> None:
        """Run the archiver at the start and whenever it is due, once there is a session."""
        if self._place[1] is None:
            return
        if begin is not None:
            await begin.wait()
        self._begun = True
        self._log.let_rows_in()
        reported = ""
        while True:
            problem = await self._run_archiver()
            if problem and problem != reported:
                self._report(reports.Severity.ALARM, f"sessions are not written: {problem}")
            reported = problem
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_RETRY_S if problem else None):
                    await self._due.wait()
            self._due.clear()

    async def _run_archiver(self, *words: str) -> str:
        return await archiver.run(self._place[0], self._pace, self._take, *words)

    # -- from the feed to the log ----------------------------------------------------------------

    async def _feed_for_ever(self) -> None:
        deadline = self._clock()[0] + self._pace.flush_s
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(0.0, deadline - self._clock()[0])):
                    self._note(await self._events.take())
            if self._clock()[0] >= deadline:
                deadline = self._clock()[0] + self._pace.flush_s
                await self._gather()
                self._count()

    def _note(self, noted: Iterable[reports.Event | reports.CommandReport]) -> None:
        now_s, wall_s = self._clock()
        utc = datetime.fromtimestamp(wall_s, UTC)
        for report in noted:
            is_event = isinstance(report, reports.Event)
            kind = records.Kind.EVENT if is_event else records.Kind.COMMAND
            row = records.note_row(report, utc, now_s, next(self._numbers))
            self._log.append(kind, msgspec.msgpack.encode(row))
            if isinstance(report, reports.Event) and report.kind == log_files.TRIP:
                # once its record is complete
                loop = asyncio.get_running_loop()
                loop.call_later(self._pace.trip_s + 0.1, self._due.set)

    async def _gather(self) -> None:
        """Turn queued reports into columns and rows; cancelled half-way, it loses none."""
        if self._place[1] is None:
            for queue in (self._slow, self._sensors, self._ticks):
                queue.drain()
            return
        self._append_rows(records.Kind.SLOW, [*map(records.slow_row, self._slow.drain())])
        sensors = map(records.sensor_row, self._sensors.drain())
        self._append_rows(records.Kind.SENSORS, [row for row in sensors if len(row) > 1])
        self._waiting += self._ticks.drain()
        while self._waiting:
            ticks = [self._waiting.popleft() for _ in range(min(_SLICE, len(self._waiting)))]
            self._last_tick = ticks[-1].measurement.tick
            packed = msgspec.msgpack.encode(records.packed_ticks(ticks))
            self._log.append(records.Kind.TICKS, packed, len(ticks))
            await asyncio.sleep(0)

    def _append_rows(self, kind: records.Kind, rows: Sequence[dict[str, Any]]) -> None:
        if rows:
            self._log.append(kind, msgspec.msgpack.encode(rows), len(rows))

    def _count(self, *, last: bool = False) -> None:
        """Report what was dropped, once that or the recording ends, and have the log say so."""
        overflow = self._log.dropped
        queued = session.Dropped(self._ticks.dropped, self._slow.dropped, self._events.dropped)
        dropped = overflow + queued
        stalled = overflow != self._overflow or (self._stalled and self._log.is_behind())
        self._overflow = overflow
        if stalled and not self._stalled:
            why = "the disk has stalled"
            if self._log.failing:
                why = "no more ticks can wait until recording continues"
            self._report(reports.Severity.WARNING, f"{why}; ticks are lost")
        self._stalled = stalled
        new = dropped != self._reported_loss and (last or not stalled)
        if new:
            self._reported_loss = dropped
            self._report(reports.Severity.WARNING, f"not recorded so far: {dropped}")
        now_s = self._clock()[0]
        if new or last or now_s - self._counted_s >= _COUNTED_S:
            self._counted_s = now_s
            self._log.append(records.Kind.DROPPED, msgspec.msgpack.encode(dropped))

    async def _finish(self) -> None:
        part_s = self._pace.close_s / 2.0
        await self._gather()
        self._note(self._events.drain())
        self._count(last=True)
        self._note(self._events.drain())  # with the loss that this has reported
        written = await self._log.close(part_s)
        self.complete = not self._begun or (written and self._directory is not None)
        if not self.complete:
            why = "; ".join(filter(None, self._log.problems.values())) or "the disk does not answer"
            self._report(reports.Severity.ALARM, f"the end of the session is not recorded: {why}")
        elif self._begun:
            await self._close_session(part_s)

    async def _close_session(self, patience_s: float) -> None:
        problem = "the disk is slow"
        if self._log.closed:
            problem = f"it takes longer than {patience_s:g} s"
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience_s):
                    problem = await self._run_archiver(archiver.NO_FIGURE)
        if problem:
            detail = f"the archiver, or the next start, completes the session's files: {problem}"
            self._report(reports.Severity.WARNING, detail)

    def _on_problem(self, what: str, why: str) -> None:
        begun = self._directory is not None
        if why and what == SYNC:
            risk = f"a power cut may take what is written: {why}"
            self._report(reports.Severity.WARNING, risk)
        elif why:
            self._report(reports.Severity.ALARM, f"{STOPPED if begun else UNBEGUN}: {why}")
        elif what != SYNC and not self._log.failing:
            self._report(reports.Severity.INFO, "recording continues")

    def _take(self, line: archiver.Line) -> None:
        """Publish what the archiver reports."""
        if isinstance(line, HealthReport):
            self._publish(line)
        else:
            self._report(*line)

    def _report(
        self, severity: reports.Severity, detail: str, kind: str = archiver.EVENT_KIND
    ) -> None:
        self._publish(reports.Event(kind, severity, detail, self._last_tick))


def with_folders(header: records.Header, log: Path, sessions: Path | None) -> records.Header:
    """Return facts with the folders, each seen from the other: both may be moved together."""
    if sessions is None:
        return header
    seen = _seen_from(sessions, log)
    try:
        seen.encode()
    except UnicodeEncodeError:
        seen = ""  # then a reader has to wait for the archiver
    info = msgspec.structs.replace(header.info, log=seen)
    return msgspec.structs.replace(header, info=info, sessions=_seen_from(log.parent, sessions))


def _seen_from(folder: Path, other: Path) -> str:
    """Return the path of a folder from another one, which is its own where they are far apart."""
    near = folder in {other.parent, other.parent.parent}
    return os.path.relpath(other, folder) if near else str(other)
