"""The recorder service in the control process, and the archiver as that process sees it."""

import asyncio
import contextlib
import itertools
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from adaptdrive.recording import journal, journal_files, records, session, writer
from adaptdrive.runtime import reports
from adaptdrive.util.clock import in_thread

# The archiver as the control process sees it: started when it is due, its output read by line.

_RETRY_S = 60.0
"""Pause of the archiver after a failure."""


class Archiving:
    """Makes the folder of a session, and runs the archiver at the start and whenever it is due.

    Attributes:
        directory: Folder of the session, None before it is made.
    """

    def __init__(
        self,
        log: Path,
        sessions: Path | None,
        header: records.Header,
        report: Callable[[reports.Severity, str], None],
        pace: journal.RecordingPace,
    ) -> None:
        """Start nothing yet.

        Args:
            log: Folder of the log.
            sessions: Folder of all sessions; without one there is nothing to do.
            header: The session that is recorded.
            report: Takes events, in the event loop.
            pace: Intervals of the recorder.
        """
        self.directory: Path | None = None
        self._sessions = sessions
        self._header = header
        program = [sys.executable, "-P", "-m", "adaptdrive.recording.archiver"]
        self._command = [*program, str(log), str(pace.trip_s)]
        self._report = report
        self._pace = pace
        self._due = asyncio.Event()

    def make_session(self) -> None:
        """Make the folder of the session where there is none, in the thread of the log.

        Raises:
            OSError: It cannot be made.
        """
        if self._sessions is not None and self.directory is None:
            info, text = self._header.info, self._header.config_text
            found = session.session_of(self._sessions, info)
            self.directory = found or session.create_session(self._sessions, info, text)

    def due(self, after_s: float = 0.0) -> None:
        """Have it run as soon as it can after a time."""
        asyncio.get_running_loop().call_later(after_s, self._due.set)

    async def run(self) -> None:
        """Run it until cancelled."""
        reported = ""
        while True:
            problem = await self.once()
            if problem and problem != reported:
                self._report(reports.Severity.ALARM, f"sessions are not written: {problem}")
            reported = problem
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_RETRY_S if problem else None):
                    await self._due.wait()
            self._due.clear()

    async def once(self, *words: str) -> str:
        """Run it until it ends; it continues where this is cancelled.

        Args:
            words: More words of its command line.

        Returns:
            Why it failed, empty where it did not.
        """
        loop = asyncio.get_running_loop()

        def notify(severity: reports.Severity, detail: str) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._report, severity, detail)

        def run() -> str:
            self._pace.start_thread()
            return _run([*self._command, *words], notify)

        try:
            return await asyncio.wrap_future(in_thread(run, "archiver"))
        except (OSError, RuntimeError) as problem:  # no further process or thread
            return str(problem)


def _run(command: Sequence[str], notify: Callable[[reports.Severity, str], None]) -> str:
    with subprocess.Popen(  # noqa: S603 - this program itself
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Ctrl-C on the terminal is for the control process
        start_new_session=True,
    ) as process:
        for line in process.stdout or ():
            with contextlib.suppress(msgspec.DecodeError):
                notify(*msgspec.json.decode(line, type=tuple[reports.Severity, str]))
        reported = b"" if process.stderr is None else process.stderr.read()
    if process.returncode == 0:
        return ""
    lines = reported.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"the archiver ended with status {process.returncode}"


# The recorder service in the control process: gather, hand over to the log, never wait.

EVENT_KIND = "recording"
"""Kind of the events about the recorder itself."""

STOPPED = "recording has stopped, control continues"
UNBEGUN = "nothing is recorded, control continues"

_SLICE = 50
"""Reports packed before the event loop gets its turn: about 0.1 ms."""

_EVENTS_HELD = 1000
_RATE_Hz = 4 * 120
"""Ticks for which queues have room between two flushes."""

_COUNTED_S = 10.0
"""Longest time between two records: the next run takes the time since the last from the clock."""


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
        clock: journal.Clock,
        pace: journal.RecordingPace = journal.RecordingPace(),  # noqa: B008 - frozen
        recalled: journal_files.Recalled = journal_files.Recalled(),  # noqa: B008 - frozen
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
        self._sessions = sessions
        header = journal.with_folders(header, log, sessions)
        held = max(1000, round(_RATE_Hz * pace.flush_s))
        self._ticks = hub.subscribe(reports.TickReport, size=held)
        self._slow = hub.subscribe(reports.LoadReport, size=held)
        self._sensors = hub.subscribe(reports.SensorSample, reports.DriveReport, size=held)
        self._events = hub.subscribe(reports.Event, reports.CommandReport, size=_EVENTS_HELD)
        self._publish = hub.publish
        self._clock = clock
        self._pace = pace
        self._archiving = Archiving(log, sessions, header, self._report, pace)
        self._log = journal.Log(
            log,
            header,
            recalled,
            clock,
            pace,
            on_status=self._on_status,
            begin_rows=self._archiving.make_session,
        )
        self._begun = False
        self._waiting: deque[reports.TickReport] = deque()
        self._numbers = itertools.count(1)
        self._reported_loss = self._overflow = session.Dropped()
        self._stalled = False
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
        folder = self._archiving.directory
        return None if folder is None else folder.name

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

    async def _archive(self, begin: asyncio.Event | None) -> None:
        if self._sessions is None:
            return
        if begin is not None:
            await begin.wait()
        self._begun = True
        self._log.let_rows_in()
        await self._archiving.run()

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
            if isinstance(report, reports.Event) and report.kind == journal_files.TRIP:
                self._archiving.due(self._pace.trip_s + 0.1)  # once its record is complete

    async def _gather(self) -> None:
        """Turn queued reports into columns and rows; cancelled half-way, it loses none."""
        if self._sessions is None:
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
        stalled = overflow != self._overflow or (self._stalled and self._log.behind)
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
        self.complete = not self._begun or (written and self._archiving.directory is not None)
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
                    problem = await self._archiving.once("--no-figure")
        if problem:
            detail = f"the archiver, or the next start, completes the session's files: {problem}"
            self._report(reports.Severity.WARNING, detail)

    def _on_status(self, outcome: writer.LogStatus) -> None:
        begun = self._archiving.directory is not None
        for what, problem in outcome.problems.items():
            if problem and what == writer.SYNC:
                risk = f"a power cut may take what is written: {problem}"
                self._report(reports.Severity.WARNING, risk)
            elif problem:
                self._report(reports.Severity.ALARM, f"{STOPPED if begun else UNBEGUN}: {problem}")
            elif what != writer.SYNC and not self._log.failing:
                self._report(reports.Severity.INFO, "recording continues")
        if outcome.part > 1:
            self._archiving.due()

    def _report(self, severity: reports.Severity, detail: str) -> None:
        self._publish(reports.Event(EVENT_KIND, severity, detail, self._last_tick))
