"""Threads that write the journal: files that are appended to, and kept by the disk in groups.

A disk may stall a write. Another thread syncs what was written, so that rows and events go into the
file meanwhile.
"""

import contextlib
import errno
import fcntl
import os
import queue
import shutil
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue

import msgspec

from adaptdrive.recording.journal_files import Begin, LogMemory, Recalled, new_file
from adaptdrive.recording.records import Header, Kind, Record, framed
from adaptdrive.util.files import require_regular

# The thread that has the disk keep what is written to the log, in groups for those who wait.

SYNC = "sync"

Job = tuple[int | None, int | None]
"""A file (None to end), and the records but rows that the log has by now (None to close it)."""


class LogStatus(msgspec.Struct, frozen=True):
    """Reports of the threads to the event loop.

    Attributes:
        synced: Records other than rows that the disk keeps by now, None for no report of them.
        problems: Why nothing, no rows, or nothing that outlasts a power cut is written, by name;
            an empty text where it is again.
        part: Segment of the session that has begun, 0 for none.
        written: Whether all is written, and nothing more will be.
        ended: Whether the disk keeps all of it, too, and the file is closed.
    """

    synced: int | None = None
    problems: dict[str, str] = {}
    part: int = 0
    written: bool = False
    ended: bool = False


def sync_for_ever(jobs: SimpleQueue[Job], notify: Callable[[LogStatus], None]) -> None:
    """Have the disk keep files of the log, each with all that was written to it before.

    Args:
        jobs: What there is to do, until a job without a file.
        notify: Takes what there is to report.
    """
    while True:
        descriptor, notes = jobs.get()
        if descriptor is None:
            notify(LogStatus(notes, ended=True))
            return
        if notes is None or jobs.empty():  # a later sync of this file serves those before it
            problem = ""
            try:
                os.fdatasync(descriptor)
            except OSError as failure:
                problem = str(failure)
            notify(LogStatus(notes, {SYNC: problem}))
        if notes is None:
            with contextlib.suppress(OSError):
                os.close(descriptor)


# Disk space set aside for a full disk: the end of a session, and the record of a trip.

_FILE = ".reserve"
_BYTES = 2 << 20
"""Two records of a trip, each of 70 s at full rate."""


def set_aside(folder: Path) -> None:
    """Occupy the reserve, where that is not done yet.

    Raises:
        OSError: There is too little space for the reserve and as much again to record into, or
            something that is no file has its name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, held = folder / _FILE, 0
    if path.exists():
        require_regular(path)
        held = path.stat().st_size
    if held >= _BYTES:
        return
    if shutil.disk_usage(folder).free < 2 * _BYTES - held:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    with path.open("ab") as file:
        os.posix_fallocate(file.fileno(), 0, _BYTES)


def release(folder: Path) -> None:
    """Give the reserve back to the disk."""
    (folder / _FILE).unlink(missing_ok=True)


# The log as the thread that writes it sees it: files that are appended to.

_LARGEST_FILE_BYTES = 4 << 20
_AT_ONCE = 50
"""Records to a write: about 0.3 ms with Python's lock."""

_FAST = 1
"""Level of compression: at 120 Hz it takes 0.06 ms, without Python's lock, four times a second."""

_PAUSE_S = 0.5
"""Shortest time from an attempt that failed to the next."""


NOTES, ROWS = "notes", "rows"


class LogWriter:
    """Writes one log.

    Attributes:
        notes: Records of events, commands and replies that wait.
        rows: Records of rows that wait; the event loop takes the oldest away where too many do.
        rows_written: Bytes of payloads of rows that wait no more.
    """

    def __init__(  # noqa: PLR0913, PLR0917 - of the log
        self,
        folder: Path,
        header: Header,
        recalled: Recalled,
        clock: Callable[[], tuple[float, float]],
        notify: Callable[[LogStatus], None],
        begin_rows: Callable[[], None],
        start_thread: Callable[[], None],
    ) -> None:
        """Touch nothing yet.

        Args:
            folder: Folder of the log.
            header: The session.
            recalled: What an earlier run has left.
            clock: Monotonic and wall time, in seconds.
            notify: Takes what there is to report.
            begin_rows: Prepares for rows, at once where that is done; may raise `OSError`.
            start_thread: What a thread does first.
        """
        self.notes: deque[Record] = deque()
        self.rows: deque[Record] = deque()
        self.rows_written = 0
        self._folder = folder
        self._header = header
        self._clock = clock
        self._notify = notify
        self._begin_rows = begin_rows
        self._start_thread = start_thread
        self._memory = LogMemory(recalled, clock()[0])
        self._file_number = recalled.file
        self._wakes: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._syncs: queue.SimpleQueue[Job] = queue.SimpleQueue()
        self._descriptor, self._path, self._size = -1, Path(), 0
        self._part, self._part_began_s = 0, 0.0
        self._taken: list[Record] = []
        self._taken_rows: list[Record] = []
        self._notes_written = 0
        self._rows_fail = False
        self._closing = threading.Event()
        self._rows_begun = threading.Event()

    def start(self) -> None:
        """Start the threads; a disk that hangs keeps neither the process nor its end.

        Raises:
            RuntimeError: This process may have no further thread.
        """
        for work in (self._write_for_ever, partial(sync_for_ever, self._syncs, self._notify)):
            threading.Thread(target=self._begin, args=(work,), name="log", daemon=True).start()
        self.wake()

    def wake(self) -> None:
        """Have what waits written; returns at once."""
        self._wakes.put(None)

    def let_rows_in(self) -> None:
        """Begin with rows, too; returns at once."""
        self._rows_begun.set()
        self.wake()

    def close(self) -> None:
        """Have the files closed once all is written; returns at once."""
        self._closing.set()
        self.wake()

    # -- the thread that writes ----------------------------------------------------------------

    def _begin(self, work: Callable[[], None]) -> None:
        self._start_thread()
        work()

    def _write_for_ever(self) -> None:
        ended = False
        while not ended:
            with contextlib.suppress(queue.Empty):
                waits = self._closing.is_set() or not self._idle
                self._wakes.get(timeout=_PAUSE_S if waits else None)
            if self._tried(NOTES, self._write_notes) and self._rows_begun.is_set():
                self._rows_fail = not self._tried(ROWS, self._write_rows)
            # after all else, so that nothing is missing where it can be read
            ended = self._closing.is_set() and self._idle and self._tried(NOTES, self._write_end)
        self._end_file()
        self._notify(LogStatus(written=True))
        self._syncs.put((None, self._notes_written))

    @property
    def _idle(self) -> bool:
        waiting = self.notes or self.rows or self._taken or self._taken_rows
        return not (waiting or self._rows_fail)

    def _write_notes(self) -> None:
        """Write events, commands and replies, on a full disk into the reserve."""
        while _fill(self._taken, self.notes):
            self._append_last(self._taken)
            self._notes_written += len(self._taken)
            self._taken.clear()
            self._syncs.put((self._descriptor, self._notes_written))

    def _write_rows(self) -> None:
        self._begin_rows()
        while _fill(self._taken_rows, self.rows):
            append = self._append_last
            if not self._closing.is_set():
                # the last space is for events, the end of a session and the record of a trip
                set_aside(self._folder)
                append = self._append
            taken = self._taken_rows
            append([replace(one, payload=zlib.compress(one.payload, _FAST)) for one in taken])
            self.rows_written += sum(len(item.payload) for item in taken)
            taken.clear()

    def _write_end(self) -> None:
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
        rest = content
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            try:
                os.ftruncate(self._descriptor, self._size)
            except OSError:
                self._end_file()
            raise
        self._size += len(content)

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
                self._notify(LogStatus(part=self._part))

    def _begin_file(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        started = self._header.info.started
        file = new_file(self._folder, self._file_number + 1, started, self._part)
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC
        self._path, self._size = file.path, 0
        self._descriptor = os.open(file.path, flags, 0o640)
        self._file_number = file.number
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            self._append_begin()
        except OSError:
            self._end_file()
            file.path.unlink(missing_ok=True)
            raise

    def _append_begin(self) -> None:
        now_s, wall_s = self._clock()
        begin = Begin(self._header, self._part, self._memory.left(now_s))
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
        self._notify(LogStatus(problems={what: why}))
        if why and self._closing.wait(_PAUSE_S):
            time.sleep(_PAUSE_S / 10.0)  # keep a broken disk from taking the processor
        return not why


def _fill(taken: list[Record], waiting: deque[Record]) -> bool:
    """Take some of what waits; return whether there is something to write."""
    with contextlib.suppress(IndexError):
        while len(taken) < _AT_ONCE:
            taken.append(waiting.popleft())
    return bool(taken)
