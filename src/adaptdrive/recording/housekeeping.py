"""Work that must not keep the recorder process from writing: a thread, one job after another."""

from __future__ import annotations

import queue
import sqlite3
import threading
from collections.abc import Callable

import pyarrow as pa

from adaptdrive.errors import AdaptdriveError

ERRORS = (AdaptdriveError, OSError, sqlite3.Error, pa.ArrowException)
"""Errors that a disk or damaged files can cause."""

Job = Callable[[], None]


class Housekeeper:
    """Closes segments, repairs and prunes sessions, while the session is written."""

    def __init__(self, warn: Callable[[str], None]) -> None:
        """Start the thread.

        Args:
            warn: Reports a job that failed; the others are done all the same.
        """
        self._warn = warn
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        # A disk that hangs must not keep the process from ending.
        self._thread = threading.Thread(target=self._work, name="housekeeper", daemon=True)
        self._thread.start()
        self.ending = threading.Event()

    def submit(self, job: Job) -> None:
        """Have a job done after those before it."""
        self._jobs.put(job)

    def finish(self) -> None:
        """Wait until all jobs are done; long ones look at `ending` and stop early."""
        self.ending.set()
        self._jobs.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except ERRORS as problem:
                self._warn(str(problem))
            except Exception as problem:  # noqa: BLE001 - reported; the other jobs need the thread
                self._warn(f"internal error: {problem!r}")
