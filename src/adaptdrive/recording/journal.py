"""The journal of a drive: what happens is appended once, and everything else is read from it.

The control process hands records over and never waits. Rows of ticks go into the file without a
sync; events, commands and replies are synced in groups, for which whoever publishes them can wait
for a bounded time. What a disk that hangs leaves waiting is bounded: the oldest rows go, counted;
an event, a command or a reply never does.
"""

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from adaptdrive.recording import journal_files, records, session
from adaptdrive.recording.writer import NOTES, ROWS, SYNC, LogStatus, LogWriter

# Settings of the recorder: intervals, and what may wait.


@dataclass(frozen=True, slots=True)
class RecordingPace:
    """Intervals and time-outs of the recorder's writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes of rows that may wait to be written; then the oldest are dropped.
            About 200 s at 120 Hz.
        close_s: Longest time that the end of the recording takes, in two parts: the log, and the
            archiver.
        trip_s: Time after a trip that belongs to its record.
        keep_s: Longest time that an event waits for its record before it is published.
        start_thread: What a thread that writes does first.
    """

    flush_s: float = 0.25
    backlog_bytes: int = 4 << 20
    close_s: float = 8.0
    trip_s: float = 10.0
    keep_s: float = 0.2
    start_thread: Callable[[], None] = lambda: None


# The log of a drive: what happened is appended once, and everything else is read from it.

Clock = Callable[[], tuple[float, float]]
"""Returns monotonic and wall time, in seconds."""


class Log:
    """Appends records; a disk that fails is tried again until it takes them.

    Attributes:
        dropped: Rows that went because too many waited.
        closed: True once the disk keeps all of it, and the file is closed.
        problems: Why nothing (`notes`), no rows (`rows`) or nothing that outlasts a power cut
            (`sync`) is written; empty texts while all is.
    """

    def __init__(  # noqa: PLR0913 - of the log
        self,
        folder: Path,
        header: records.Header,
        recalled: journal_files.Recalled,
        clock: Clock,
        pace: RecordingPace,
        *,
        on_status: Callable[[LogStatus], None],
        begin_rows: Callable[[], None] = lambda: None,
    ) -> None:
        """Touch nothing yet.

        Args:
            folder: Folder of the log.
            header: The session.
            recalled: What an earlier run has left.
            clock: Clocks of the records.
            pace: What may wait, and what a thread does first.
            on_status: Takes reports of the threads, in the event loop.
            begin_rows: Prepares for rows, in a thread; may raise `OSError`, and is called again.
        """
        self.dropped = session.Dropped()
        self.closed = False
        self.problems = {NOTES: "", ROWS: "", SYNC: ""}
        self._clock = clock
        self._on_status = on_status
        self._backlog_bytes = pace.backlog_bytes
        self._writer = LogWriter(
            folder, header, recalled, clock, self._notify, begin_rows, pace.start_thread
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._notes = self._synced = self._rows_bytes = 0
        self._in_vain_s = 0.0
        self._written = False
        self._changed = asyncio.Event()

    @property
    def failing(self) -> bool:
        """True while what is appended is not written."""
        return any(self.problems.values())

    @property
    def behind(self) -> bool:
        """True while half as many rows wait as may."""
        return self._waiting_bytes > self._backlog_bytes // 2

    @property
    def _waiting_bytes(self) -> int:
        return self._rows_bytes - self._writer.rows_written

    def start(self) -> None:
        """Begin to write.

        Raises:
            RuntimeError: This process may have no further thread.
        """
        self._loop = asyncio.get_running_loop()
        try:
            self._writer.start()
        except RuntimeError:
            self._loop = None
            raise

    def let_rows_in(self) -> None:
        """Begin to write rows; those that were appended before wait for this."""
        self._writer.let_rows_in()

    def append(self, kind: records.Kind, payload: bytes, rows: int = 0) -> None:
        """Hand a record over; returns at once.

        Args:
            kind: Its kind.
            payload: Its contents.
            rows: Rows of tables in it.
        """
        item = records.Record(0, *self._clock(), kind, payload, rows)
        if kind in records.ROW_KINDS:
            self._rows_bytes += len(payload)
            self._writer.rows.append(item)
            self._bound()
        else:
            self._notes += 1
            self._writer.notes.append(item)
        self._writer.wake()

    async def kept(self, patience_s: float) -> None:
        """Wait until the disk keeps the records other than rows that were appended so far.

        A disk that takes longer is waited for once, and then not before it has answered; one that
        fails is not waited for.

        Args:
            patience_s: Longest wait.
        """
        if self._loop is None or self._in_vain_s >= patience_s:
            return
        notes = self._notes
        if not await self._until(
            lambda: self._synced >= notes or bool(self.problems[NOTES]), patience_s
        ):
            self._in_vain_s = patience_s

    async def close(self, patience_s: float) -> bool:
        """Write what waits and close the file.

        Args:
            patience_s: Longest wait.

        Returns:
            Whether all is written; `closed` is False where the disk has not confirmed that.
        """
        if self._loop is not None:
            self._writer.close()
            await self._until(lambda: self.closed, patience_s)
        return self._written

    async def _until(self, done: Callable[[], bool], patience_s: float) -> bool:
        """Wait until a report of the threads makes something true; return whether it is."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                while not done():
                    await self._changed.wait()
        return done()

    def _bound(self) -> None:
        """Drop the oldest rows where too many wait."""
        writer = self._writer
        while self._waiting_bytes > self._backlog_bytes:
            try:
                oldest = writer.rows.popleft()
            except IndexError:  # all of it is being written
                return
            self._rows_bytes -= len(oldest.payload)
            if oldest.kind is records.Kind.TICKS:
                self.dropped += session.Dropped(ticks=oldest.rows)
            elif oldest.kind is records.Kind.SLOW:
                self.dropped += session.Dropped(slow=oldest.rows)

    def _notify(self, status: LogStatus) -> None:
        """Pass a report of a thread to the event loop, which may have ended."""
        known = self.problems.items()
        problems = {what: why for what, why in status.problems.items() if (what, why) not in known}
        self.problems |= problems
        status = msgspec.structs.replace(status, problems=problems)
        if self._loop is not None and status != LogStatus():
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._take, status)

    def _take(self, status: LogStatus) -> None:
        if status.synced is not None:
            self._synced, self._in_vain_s = status.synced, 0.0
        self._written |= status.written
        self.closed |= status.ended
        self._changed.set()
        self._changed = asyncio.Event()
        self._on_status(status)


# Folders of a session, each seen from the other.


def with_folders(header: records.Header, log: Path, sessions: Path | None) -> records.Header:
    """Return facts with the folders, each seen from the other: both may be moved together."""
    if sessions is None:
        return header
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
