"""A copy, in a file, of what the recorder process has not written yet.

It outlives both processes: the next start writes it into the session (`recovery.py`). A thread
appends to the file, so that a disk that hangs delays nothing. The file is locked while the control
process lives.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import functools
import os
import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from adaptdrive.recording.session import SessionInfo, time_in_name

_PREFIX = ".unwritten-"
_LARGEST_QUEUE_BYTES = 4 << 20
"""Bytes that wait for a disk that hangs; beyond them the file is given up."""


def spool_path(sessions: Path, info: SessionInfo) -> Path:
    """Return the path of the spool of one session.

    Args:
        sessions: Folder of all sessions.
        info: The session.
    """
    return sessions / f"{_PREFIX}{time_in_name(info.started)}_{info.drive}"


def left_spools(sessions: Path) -> list[Path]:
    """Return the spools in a folder, those in use included."""
    return sorted(sessions.glob(f"{_PREFIX}*"))


def waiting_spools(sessions: Path) -> list[Path]:
    """Return the spools with contents whose control process has ended: the next start writes them.

    Args:
        sessions: Folder of all sessions.
    """
    return [path for path in left_spools(sessions) if _waits(path)]


def _waits(path: Path) -> bool:
    try:
        if not path.is_file() or not path.stat().st_size:
            return False
        with path.open("rb") as source:
            return is_free(source, fcntl.LOCK_SH)  # shared: two may look at once
    except (FileNotFoundError, PermissionError):
        return False  # of one that may not be read nothing is known, such as that of a daemon
    except OSError:
        return True


def is_free(source: BinaryIO, lock: int = fcntl.LOCK_EX) -> bool:
    """Take the lock of a spool until it is closed; False where another process has it.

    Args:
        source: The spool.
        lock: Kind of the lock, as for `flock`.
    """
    try:
        fcntl.flock(source, lock | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class Spool:
    """Appends messages to a file, and empties it when they are written elsewhere.

    Attributes:
        size: Bytes appended since the file was empty.
        sound: Whether the file has all that was appended so far.
        lost: Whether the file was deleted or moved; it begins anew after `clear`.
    """

    def __init__(self, path: Path, start_thread: Callable[[], None] = lambda: None) -> None:
        """Touch nothing yet.

        Args:
            path: The file.
            start_thread: What the thread does first.
        """
        self.size = 0
        self.sound = True
        self.lost = False
        self.path = path
        self._start_thread = start_thread
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._handed_over = 0  # bytes, counted by the owner of this object
        self._done = 0  # of them, counted by the thread
        self._slow = False
        self._descriptor = -1
        self._thread: threading.Thread | None = None

    def append(self, message: bytes) -> None:
        """Append a message soon; returns at once."""
        if self._overfull:
            self.sound = False
            return
        if self._submit(lambda: self._write(message)):
            self._handed_over += len(message)
            self.size += len(message)

    def clear(self) -> None:
        """Empty the file soon, unless the disk hangs; returns at once."""
        if self._overfull:
            return
        self.size, self.sound, self.lost = 0, True, False
        self._submit(self._truncate)

    @property
    def _overfull(self) -> bool:
        return self._handed_over - self._done > _LARGEST_QUEUE_BYTES

    async def kept(self, patience_s: float) -> None:
        """Wait until the file has what was appended, or could not take it.

        A disk that takes longer is waited for once, and then not before it has answered.

        Args:
            patience_s: Longest wait.
        """
        if self._slow or self._done == self._handed_over:
            return
        loop, done = asyncio.get_running_loop(), asyncio.Event()
        if not self._submit(functools.partial(_tell, loop, done)):
            return
        try:
            async with asyncio.timeout(patience_s):
                await done.wait()
        except TimeoutError:
            self._slow = self._done != self._handed_over

    def flushed(self, patience_s: float) -> bool:
        """Wait until the file has all that was appended; False when the disk hangs.

        Args:
            patience_s: Longest wait.
        """
        done = threading.Event()
        self._submit(self._require_in_place)
        return self._submit(done.set) and done.wait(patience_s) and self.sound

    def remove(self) -> None:
        """Remove the file soon, if there is one, and end the thread."""
        if self._thread is not None:
            self._submit(self._unlink)
            self._jobs.put(None)

    def _submit(self, job: Callable[[], None]) -> bool:
        """Have the thread do a job; False when this process may have no further thread."""
        if self._thread is None:
            # a disk that hangs must not keep the process from ending
            thread = threading.Thread(target=self._work, name="spool", daemon=True)
            try:
                thread.start()
            except RuntimeError:
                self.sound = False
                return False
            self._thread = thread
        self._jobs.put(job)
        return True

    def _work(self) -> None:
        self._start_thread()
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except OSError:
                self.sound = False
            self._slow = False

    def _write(self, message: bytes) -> None:
        try:
            self._require_in_place()
            if self._descriptor < 0:
                self._open()
            self._append_whole(message)
        finally:
            self._done += len(message)

    def _append_whole(self, message: bytes) -> None:
        """Append a message; one for which there is no room leaves nothing behind."""
        end = os.fstat(self._descriptor).st_size
        try:
            while message:
                message = message[os.write(self._descriptor, message) :]
        except OSError:
            os.ftruncate(self._descriptor, end)
            raise

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(self.path, os.O_CREAT | os.O_WRONLY | os.O_APPEND, 0o640)
        fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _require_in_place(self) -> None:
        """Refuse to go on with an open file that the next start would not find."""
        if self._descriptor >= 0 and not self._is_in_place():
            self.lost = True
            raise FileNotFoundError(self.path)

    def _is_in_place(self) -> bool:
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self._descriptor))
        except (FileNotFoundError, NotADirectoryError):
            return False

    def _truncate(self) -> None:
        """Empty the file; one that cannot be emptied is deleted, and the next one begins anew."""
        if self._descriptor < 0:
            return
        try:
            if self._is_in_place():
                os.ftruncate(self._descriptor, 0)
                return
        except OSError:
            self._unlink()
        os.close(self._descriptor)
        self._descriptor = -1

    def _unlink(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()


def _tell(loop: asyncio.AbstractEventLoop, done: asyncio.Event) -> None:
    with contextlib.suppress(RuntimeError):  # the loop that waited has ended
        loop.call_soon_threadsafe(done.set)
