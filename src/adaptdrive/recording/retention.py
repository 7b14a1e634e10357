"""Retention: which sessions and segments go when space is short, or time has passed.

Ages follow the wall clock, which may be wrong at the start of a machine. A recorder removes
sessions for their age only while one session, its own included, began at least a day and at most
`keep.days` ago: after the clock has leapt ahead there is none.

A symbolic link to a session, such as one that was moved to another disk, takes no room here: it is
neither counted nor removed.
"""

import math
import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from adaptdrive.recording import log_files, session
from adaptdrive.recording.records import Keep
from adaptdrive.recording.segments import segments
from adaptdrive.util.errors import RecordingError

_DAY_S = 86_400.0

_CONFIRMED_DAYS = 1.0
"""Age of the session that confirms the clock: a wrong one is noticed or set within this time."""


def prune(sessions: Path, keep: Keep, now: datetime, current: Path | None = None) -> Iterator[str]:
    """Remove what is too old or too much.

    The oldest sessions go first, then the oldest segments of the session in progress.

    Args:
        sessions: Folder of all sessions.
        keep: How long sessions are kept.
        now: Present time, UTC.
        current: The session in progress, which loses closed segments at most; None where a person
            has asked for the removal.

    Yields:
        A sentence for each removal.

    Raises:
        RecordingError: A session cannot be removed; the others are.
    """
    found = [path for path in session.session_directories(sessions) if not path.is_symlink()]
    sizes = {path: size_of(path) for path in found}
    outdated = _too_old(found, keep, now, by_person=current is None)
    excess = -math.inf if keep.bytes is None else sum(sizes.values()) - keep.bytes
    failed: list[RecordingError] = []
    for directory in (path for path in found if path != current):
        cause = f"it is older than {keep.days:g} days" if directory in outdated else ""
        if excess > 0:
            cause = f"sessions take more than {(keep.bytes or 0) / 1e6:g} MB"
        try:
            removed = bool(cause) and _remove(directory)
        except OSError as problem:
            failed.append(RecordingError(directory, f"the session cannot be removed: {problem}"))
            continue
        if removed:
            excess -= sizes[directory]
            yield f"session {directory.name} removed: {cause}"
    yield from _prune_segments(current, excess) if current else ()
    if failed:
        raise failed[0]


def _prune_segments(directory: Path, excess: float) -> Iterator[str]:
    for segment in segments(directory, None, session.TABLES):
        if excess <= 0:
            return
        path = segment.path
        excess -= path.stat().st_size
        path.unlink()
        yield f"{path.name} of session {directory.name} removed: sessions take too much"


def _remove(directory: Path) -> bool:
    """Remove a session; another drive that shares the folder, or a person, may have done it."""
    # nobody writes a session whose facts cannot be read
    with suppress(RecordingError):
        if log_files.in_progress(directory, session.read_info(directory)):
            return False
    with suppress(FileNotFoundError):
        shutil.rmtree(directory)
        return True
    return False


def _too_old(directories: list[Path], keep: Keep, now: datetime, *, by_person: bool) -> set[Path]:
    """Return the sessions that are too old, none where no session shows the clock to be right."""
    if keep.days is None:
        return set()
    ages_days: dict[Path, float] = {}
    for path in directories:
        # one that cannot be read is left for a person
        with suppress(RecordingError):
            ages_days[path] = (now - session.read_info(path).started).total_seconds() / _DAY_S
    least_days = min(_CONFIRMED_DAYS, 0.5 * keep.days)
    if by_person or any(least_days <= age_days <= keep.days for age_days in ages_days.values()):
        return {path for path, age_days in ages_days.items() if age_days > keep.days}
    return set()


def size_of(directory: Path) -> int:
    """Return the bytes of the files in a folder; what is removed meanwhile takes none."""
    size = 0
    for path in (Path(folder, name) for folder, _, names in os.walk(directory) for name in names):
        with suppress(OSError):
            size += path.stat().st_size if path.is_file() else 0
    return size
