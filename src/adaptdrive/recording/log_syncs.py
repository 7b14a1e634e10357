"""The thread that has the disk keep what is written to the log, in groups for those who wait."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from queue import SimpleQueue

import msgspec

SYNC = "sync"

Job = tuple[int | None, int | None]
"""A file (None to end), and the records but rows that the log has by now (None to close it)."""


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


def sync_for_ever(jobs: SimpleQueue[Job], tell: Callable[[LogNews], None]) -> None:
    """Have the disk keep files of the log, each with all that was written to it before.

    Args:
        jobs: What there is to do, until a job without a file.
        tell: Takes what there is to report.
    """
    while True:
        descriptor, notes = jobs.get()
        if descriptor is None:
            tell(LogNews(notes, ended=True))
            return
        if notes is None or jobs.empty():  # a later sync of this file serves those before it
            problem = ""
            try:
                os.fdatasync(descriptor)
            except OSError as failure:
                problem = str(failure)
            tell(LogNews(notes, {SYNC: problem}))
        if notes is None:
            with contextlib.suppress(OSError):
                os.close(descriptor)
