"""The thread that has the disk keep what is written to the log, in groups for those who wait."""

from __future__ import annotations

import contextlib
import os
import queue
from collections.abc import Callable

import msgspec

SYNC = "sync"
_CLOSE = -1


class LogNews(msgspec.Struct, frozen=True):
    """Reports of the threads to the event loop.

    Attributes:
        synced: Records other than rows that the disk keeps by now, None for no news of them.
        problems: Why nothing, no rows, or nothing that outlasts a power cut is written, by name;
            an empty text where it is again.
        part: Segment of the session that has begun, 0 for no news.
        written: Whether all is written, and nothing more will be.
        ended: Whether the disk keeps all of it, too, and the file is closed.
    """

    synced: int | None = None
    problems: dict[str, str] = {}
    part: int = 0
    written: bool = False
    ended: bool = False


class LogSyncs:
    """Syncs files of the log, each after all that was written to it before."""

    def __init__(self, tell: Callable[[LogNews], None]) -> None:
        """Sync nothing yet.

        Args:
            tell: Takes what there is to report.
        """
        self._tell = tell
        self._jobs: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()

    def keep(self, descriptor: int, notes: int) -> None:
        """Have the disk keep a file; returns at once.

        Args:
            descriptor: The file.
            notes: Records other than rows that the log has by now.
        """
        self._jobs.put((descriptor, notes))

    def close(self, descriptor: int) -> None:
        """Have the disk keep a file, and close it; returns at once."""
        self._jobs.put((descriptor, _CLOSE))

    def end(self, notes: int) -> None:
        """End the thread after all of this; returns at once."""
        self._jobs.put((_CLOSE, notes))

    def run(self) -> None:
        """Sync until `end`."""
        while True:
            descriptor, notes = self._jobs.get()
            if descriptor == _CLOSE:
                self._tell(LogNews(synced=notes, ended=True))
                return
            if notes == _CLOSE:
                self._sync(descriptor, None)
                with contextlib.suppress(OSError):
                    os.close(descriptor)
            elif self._jobs.empty():  # a later sync of this file serves those before it
                self._sync(descriptor, notes)

    def _sync(self, descriptor: int, notes: int | None) -> None:
        """Have the disk keep a file."""
        problem = ""
        try:
            os.fdatasync(descriptor)
        except OSError as failure:
            problem = str(failure)
        self._tell(LogNews(notes, {SYNC: problem}))
