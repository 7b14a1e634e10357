"""The log of a drive: what happens is appended once, and everything else is read from it.

The control process hands records over and never waits. Rows of ticks go into the file without a
sync; events, commands and replies are synced in groups, for which whoever publishes them can wait
for a bounded time. What a disk that hangs leaves waiting is bounded: the oldest rows go, counted;
an event, a command or a reply never does.

A disk may stall a write or a sync: one thread writes, and another one syncs, so that rows and
events go into the file meanwhile.
"""

import asyncio
import contextlib
import errno
import fcntl
import os
import queue
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec

from adaptdrive.recording import log_files
from adaptdrive.recording.log_files import release, set_aside
from adaptdrive.recording.records import ROW_KINDS, Header, Kind, Pace, Record, framed
from adaptdrive.recording.session import Dropped

_LARGEST_FILE_BYTES = 4 << 20
_AT_ONCE = 50
"""Records to a write: about 0.3 ms with Python's lock."""

_FAST = 1
"""Level of compression: at 120 Hz it takes 0.06 ms, without Python's lock, four times a second."""

_PAUSE_S = 0.5
"""Shortest time from an attempt that failed to the next."""

NOTES, ROWS, SYNC = "notes", "rows", "sync"
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
        header: Header,
        recalled: log_files.Recalled,
        clock: Clock,
        pace: Pace,
        *,
        on_problem: Callable[[str, str], None],
        on_segment: Callable[[int], None] = lambda _: None,
        begin_rows: Callable[[], None] = lambda: None,
    ) -> None:
        """Touch nothing yet.

        Args:
            folder: Folder of the log.
            header: The session.
            recalled: What an earlier run has left.
            clock: Clocks of the records.
            pace: What may wait, and what a thread does first.
            on_problem: Takes each change of `problems`, in the event loop.
            on_segment: Takes the number of each segment that begins, in the event loop.
            begin_rows: Prepares for rows, in a thread; may raise `OSError`, and is called again.
        """
        self.dropped, self.closed = Dropped(), False
        self.problems = {NOTES: "", ROWS: "", SYNC: ""}
        self._folder, self._header, self._clock, self._pace = folder, header, clock, pace
        self._on_problem, self._on_segment = on_problem, on_segment
        self._begin_rows = begin_rows
        self._loop: asyncio.AbstractEventLoop | None = None
        self._changed = asyncio.Event()
        self._in_vain_s = 0.0
        self._written = False
        # records that wait, and those that are being written
        self._notes, self._rows = deque[Record](), deque[Record]()
        self._taken, self._taken_rows = list[Record](), list[Record]()
        self._noted = self._notes_written = self._notes_synced = 0
        self._rows_bytes = self._rows_written = 0
        self._wakes: queue.SimpleQueue[None] = queue.SimpleQueue()
        # files (None to end), each with the notes that the log has by now (None to close the file)
        self._syncs: queue.SimpleQueue[tuple[int | None, int | None]] = queue.SimpleQueue()
        self._closing, self._rows_begun = threading.Event(), threading.Event()
        self._memory = log_files.LogMemory(recalled, clock()[0])
        self._file_number = recalled.file
        self._descriptor, self._path, self._size = -1, Path(), 0
        self._part, self._part_began_s = 0, 0.0

    # -- the event loop ------------------------------------------------------------------------

    @property
    def failing(self) -> bool:
        """True while what is appended is not written."""
        return any(self.problems.values())

    def is_behind(self, share: float = 0.5) -> bool:
        """Return whether more rows wait than a share of those that may."""
        return self._rows_bytes - self._rows_written > share * self._pace.backlog_bytes

    def start(self) -> None:
        """Begin to write; a disk that hangs keeps neither the process nor its end.

        Raises:
            RuntimeError: This process may have no further thread.
        """
        self._loop = asyncio.get_running_loop()
        try:
            for work in (self._write_for_ever, self._sync_for_ever):
                threading.Thread(target=self._run, args=(work,), name="log", daemon=True).start()
        except RuntimeError:
            self._loop = None
            raise

    def let_rows_in(self) -> None:
        """Begin to write rows; those that were appended before wait for this."""
        self._rows_begun.set()
        self._wake()

    def append(self, kind: Kind, payload: bytes, rows: int = 0) -> None:
        """Hand a record over; returns at once.

        Args:
            kind: Its kind.
            payload: Its contents.
            rows: Rows of tables in it.
        """
        item = Record(0, *self._clock(), kind, payload, rows)
        if kind in ROW_KINDS:
            self._rows_bytes += len(payload)
            self._rows.append(item)
            self._bound()
        else:
            self._noted += 1
            self._notes.append(item)
        self._wake()

    async def kept(self, patience_s: float) -> None:
        """Wait until the disk keeps the records other than rows that were appended so far.

        A disk that takes longer is waited for once, and then not before it has answered; one that
        fails is not waited for.

        Args:
            patience_s: Longest wait.
        """
        if self._loop is None or self._in_vain_s >= patience_s:
            return
        notes = self._noted
        if not await self._until(
            lambda: self._notes_synced >= notes or bool(self.problems[NOTES]), patience_s
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
            self._closing.set()
            self._wake()
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
        while self.is_behind(1.0):
            try:
                oldest = self._rows.popleft()
            except IndexError:  # all of it is being written
                return
            self._rows_bytes -= len(oldest.payload)
            if oldest.kind is Kind.TICKS:
                self.dropped += Dropped(ticks=oldest.rows)
            elif oldest.kind is Kind.SLOW:
                self.dropped += Dropped(slow=oldest.rows)

    def _wake(self) -> None:
        self._wakes.put(None)

    # -- from the threads to the event loop, which may have ended --------------------------------

    def _report(self, take: Callable[..., None], *values: object) -> None:
        def taken() -> None:
            take(*values)
            self._changed.set()
            self._changed = asyncio.Event()

        if self._loop is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(taken)

    def _report_problem(self, what: str, why: str) -> None:
        if self.problems[what] != why:
            self.problems[what] = why
            self._report(self._on_problem, what, why)

    def _take_sync(self, notes: int) -> None:
        self._notes_synced, self._in_vain_s = notes, 0.0

    # -- the thread that syncs -------------------------------------------------------------------

    def _run(self, work: Callable[[], None]) -> None:
        self._pace.start_thread()
        work()

    def _sync_for_ever(self) -> None:
        while True:
            descriptor, notes = self._syncs.get()
            if descriptor is None:
                self.closed = True
                return self._report(self._take_sync, notes)
            if notes is None or self._syncs.empty():  # a later sync of a file serves those before
                try:
                    os.fdatasync(descriptor)
                    self._report_problem(SYNC, "")
                except OSError as failure:
                    self._report_problem(SYNC, str(failure))
                if notes is not None:
                    self._report(self._take_sync, notes)
            if notes is None:
                with contextlib.suppress(OSError):
                    os.close(descriptor)

    # -- the thread that writes ------------------------------------------------------------------

    def _write_for_ever(self) -> None:
        ended = False
        while not ended:
            with contextlib.suppress(queue.Empty):
                waits = self._closing.is_set() or not self._idle
                self._wakes.get(timeout=_PAUSE_S if waits else None)
            if self._tried(NOTES, self._write_notes) and self._rows_begun.is_set():
                self._tried(ROWS, self._write_rows)
            # after all else, so that nothing is missing where it can be read
            ended = self._closing.is_set() and self._idle and self._tried(NOTES, self._append_end)
        self._end_file()
        self._written = True
        self._syncs.put((None, self._notes_written))

    @property
    def _idle(self) -> bool:
        waiting = self._notes or self._rows or self._taken or self._taken_rows
        return not (waiting or self.problems[ROWS])

    def _write_notes(self) -> None:
        while _fill(self._taken, self._notes):
            self._append_last(self._taken)
            self._notes_written += len(self._taken)
            self._taken.clear()
            self._syncs.put((self._descriptor, self._notes_written))

    def _write_rows(self) -> None:
        self._begin_rows()
        while _fill(self._taken_rows, self._rows):
            append = self._append_last
            if not self._closing.is_set():
                # the last space is for events, the end of a session and the record of a trip
                set_aside(self._folder)
                append = self._append
            taken = self._taken_rows
            append([replace(one, payload=zlib.compress(one.payload, _FAST)) for one in taken])
            self._rows_written += sum(len(item.payload) for item in taken)
            taken.clear()

    def _append_end(self) -> None:
        self._append_last([Record(0, *self._clock(), Kind.END, b"")])

    def _append_last(self, items: list[Record]) -> None:
        """Append, on a full disk into the reserve."""
        try:
            self._append(items)
        except OSError as problem:
            if problem.errno not in {errno.ENOSPC, errno.EDQUOT}:
                raise
            release(self._folder)
            self._append(items)

    def _append(self, items: list[Record]) -> None:
        self._require_file()
        numbered = enumerate(items, self._memory.number + 1)
        records = [replace(item, number=number) for number, item in numbered]
        self._write(b"".join(map(framed, records)))
        for record in records:
            self._memory.take(record)

    def _write(self, content: bytes) -> None:
        """Append to the file; what does not fit leaves nothing behind, or the file is given up."""
        size = self._size + len(content)
        try:
            while content:
                content = content[os.write(self._descriptor, content) :]
        except OSError:
            try:
                os.ftruncate(self._descriptor, self._size)
            except OSError:
                self._end_file()
            raise
        self._size = size

    def _require_file(self) -> None:
        """Begin a file where there is none, this one is long enough, or nobody would find it."""
        now_s = self._clock()[0]
        if self._descriptor >= 0 and not self._is_in_place():
            self._end_file()
            raise FileNotFoundError(f"{self._path} was removed or replaced")
        due = not self._part or now_s - self._part_began_s >= self._header.segment_s
        if self._descriptor < 0 or due or self._size > _LARGEST_FILE_BYTES:
            self._end_file()
            if due:
                self._part, self._part_began_s = self._part + 1, now_s
            self._begin_file()
            if due:
                self._report(self._on_segment, self._part)

    def _begin_file(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        self._file_number += 1
        started = self._header.info.started
        file = log_files.new_file(self._folder, self._file_number, started, self._part)
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC
        self._path, self._size = file.path, 0
        self._descriptor = os.open(file.path, flags, 0o640)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            self._append_begin()
        except OSError:
            self._end_file()
            file.path.unlink(missing_ok=True)
            raise

    def _append_begin(self) -> None:
        now_s, wall_s = self._clock()
        begin = log_files.Begin(self._header, self._part, self._memory.left(now_s))
        payload = msgspec.msgpack.encode(begin)
        # without a separate number: the next record has the same one in whichever file it is
        self._write(framed(Record(self._memory.number, now_s, wall_s, Kind.BEGIN, payload)))
        # before an archiver may remove the files before this one
        self._syncs.put((self._descriptor, self._notes_written))

    def _end_file(self) -> None:
        if self._descriptor >= 0:
            self._syncs.put((self._descriptor, None))
            self._descriptor = -1

    def _is_in_place(self) -> bool:
        try:
            return os.path.samestat(self._path.stat(), os.fstat(self._descriptor))
        except OSError:
            return False

    def _tried(self, what: str, act: Callable[[], None]) -> bool:
        """Do something, and report its failure or its success."""
        why = ""
        try:
            act()
        except Exception as problem:  # noqa: BLE001 - reported; nobody else would notice
            why = (isinstance(problem, OSError) and str(problem)) or repr(problem)
        self._report_problem(what, why)
        if why and self._closing.wait(_PAUSE_S):
            time.sleep(_PAUSE_S / 10.0)  # keep a broken disk from taking the processor
        return not why


def _fill(taken: list[Record], waiting: deque[Record]) -> bool:
    """Take some of what waits; return whether there is something to write."""
    with contextlib.suppress(IndexError):
        while len(taken) < _AT_ONCE:
            taken.append(waiting.popleft())
    return bool(taken)
