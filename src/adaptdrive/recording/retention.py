"""Retention: which sessions and segments go when space is short, or time has passed.

Ages follow the wall clock, which may be wrong at the start of a machine. A recorder removes
sessions for their age only while one session, its own included, began at least a day and at most
`keep.days` ago: after the clock has leapt ahead there is none.

A symbolic link to a session, such as one that was moved to another disk, takes no room here: it is
neither counted nor removed.
"""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from adaptdrive.recording import journal_files, session
from adaptdrive.recording.records import Keep
from adaptdrive.recording.segments import segments
from adaptdrive.util.errors import RecordingError

_DAY_S = 86_400.0

_CONFIRMED_DAYS = 1.0
"""Age of the session that confirms the clock: a wrong one is noticed or set within this time."""


def prune(sessions: Path, keep: Keep, now: datetime, current: Path | None = None) -> Iterator[str]:
    """Remove what is too old or too much.

    Args:
        sessions: Folder of all sessions.
        keep: How long sessions are kept.
        now: Present time, UTC.
        current: The session in progress, which loses closed segments at most; None where a person
            has asked for the removal.

    The oldest sessions go first, then the oldest segments of the session in progress.

    Yields:
        A sentence for each removal.

    Raises:
        RecordingError: A session cannot be removed; the others are.
    """
    directories = [path for path in session.session_directories(sessions) if not path.is_symlink()]
    older = [path for path in directories if path != current]
    outdated = _too_old(directories, keep, now, by_person=current is None)
    excess = sum(map(size_of, directories)) - keep.bytes if keep.bytes is not None else 0
    failed: list[RecordingError] = []
    for directory in older:
        size = size_of(directory)
        if excess > 0:
            cause = f"sessions take more than {(keep.bytes or 0) / 1e6:g} MB"
        elif directory in outdated:
            cause = f"it is older than {keep.days:g} days"
        else:
            continue
        try:
            removed = _remove(directory)
        except FileNotFoundError:
            continue  # another drive that shares the folder, or a person, has removed it
        except OSError as problem:
            failed.append(RecordingError(directory, f"the session cannot be removed: {problem}"))
            continue
        if removed:
            excess -= size
            yield f"session {directory.name} removed: {cause}"
    if current is not None and excess > 0:
        yield from _prune_segments(current, excess)
    if failed:
        raise failed[0]


def _prune_segments(directory: Path, excess: int) -> Iterator[str]:
    for segment in segments(directory, None, session.TABLES):
        if excess <= 0:
            return
        path = segment.path
        excess -= path.stat().st_size
        path.unlink()
        yield f"{path.name} of session {directory.name} removed: sessions take too much"


def _remove(directory: Path) -> bool:
    # nobody writes a session whose facts cannot be read
    with suppress(RecordingError):
        if journal_files.in_progress(directory, session.read_info(directory)):
            return False
    shutil.rmtree(directory)
    return True


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
    for folder, _, names in os.walk(directory):
        for name in names:
            with suppress(OSError):
                found = Path(folder, name).stat()
                size += found.st_size if stat.S_ISREG(found.st_mode) else 0
    return size
