"""Output that never waits for its reader: lines go through a bounded queue to a thread.

A pipe without a reader blocks its writer, and one that was closed raises. Neither may
reach the thread that controls a drive. What the queue cannot hold is dropped, oldest first, and
counted; the count is written as soon as a line gets through again.
"""

from __future__ import annotations

import io
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from select import POLLOUT, poll
from typing import TextIO, cast

from adaptdrive.util.lines import line as line_of

LINES_HELD = 500
"""Lines that wait for a reader: more than an orderly end or a trip ever writes."""

PATIENCE_S = 2.0
"""Longest wait for a reader at the end of the process."""

_LOST = "log lines lost: the reader of this log had stopped reading"


class QueuedStream(io.TextIOBase):
    """Writes whole lines to the file of another stream, from a separate thread."""

    def __init__(self, target: TextIO, start_thread: Callable[[], None] = lambda: None) -> None:
        """Start the thread.

        Args:
            target: Stream on the file; it is not used itself.
            start_thread: What the thread does first.
        """
        super().__init__()
        self._file = target.fileno()
        self._start_thread = start_thread
        self._begun = ""
        self._lines: deque[str] = deque()
        self._lost = 0
        self._busy = False
        self._changed = threading.Condition()
        threading.Thread(target=self._work, name="output", daemon=True).start()

    def write(self, text: str) -> int:
        """Queue the lines that are complete; returns at once."""
        with self._changed:
            *lines, self._begun = (self._begun + text).split("\n")
            self._lines.extend(lines)
            while len(self._lines) > LINES_HELD:
                self._lines.popleft()
                self._lost += 1
            self._changed.notify_all()
        return len(text)

    def writable(self) -> bool:
        """Always."""
        return True

    def fileno(self) -> int:
        """The file that the lines end in."""
        return self._file

    def drain(self, deadline_s: float) -> bool:
        """Wait until every line has been written.

        Args:
            deadline_s: End of the wait, monotonic.

        Returns:
            Whether none waits and none was lost without a word.
        """
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._lines or self._busy or self._lost),
                max(0.0, deadline_s - time.monotonic()),
            )

    def _work(self) -> None:
        self._start_thread()
        while True:
            line, lost = self._next()
            announced = not lost or self._put(line_of("warning", _LOST, lost=lost))
            written = self._put(line)
            with self._changed:
                self._lost += (0 if announced else lost) + (0 if written else 1)
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> tuple[str, int]:
        """Wait for a line; it, and how many went missing before it."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._lines))
            self._busy = True
            lost, self._lost = self._lost, 0
            return self._lines.popleft(), lost

    def _put(self, line: str) -> bool:
        """Write a line, for as long as that takes; False when the file refuses it."""
        rest = f"{line}\n".encode(errors="backslashreplace")
        while rest:
            try:
                rest = rest[os.write(self._file, rest) :]
            except BlockingIOError:  # another process with this file has made it non-blocking
                _await_room(self._file)
            except OSError:
                return False
        return True


def _await_room(file: int) -> None:
    waiting = poll()
    waiting.register(file, POLLOUT)
    waiting.poll()


@contextmanager
def unblocked_output(start_thread: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Have everything that this process prints go through queues until the block ends.

    The plain streams come back when their readers have taken everything. Otherwise the queues stay:
    what is printed after the block must not hang either.

    Args:
        start_thread: What a thread does first.
    """
    plain = sys.stdout, sys.stderr
    queued = tuple(QueuedStream(stream, start_thread) for stream in plain)
    sys.stdout, sys.stderr = cast("tuple[TextIO, TextIO]", queued)
    try:
        yield
    finally:
        deadline_s = time.monotonic() + PATIENCE_S
        drained = [stream.drain(deadline_s) for stream in queued]
        if all(drained):
            sys.stdout, sys.stderr = plain
