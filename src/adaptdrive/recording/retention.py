"""Retention: the oldest sessions go first, then the oldest segments of the session in progress."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import Keep
from adaptdrive.recording.segments import segments
from adaptdrive.recording.session import SessionLock, read_info, session_directories

_DAY_S = 86_400.0


def prune(sessions: Path, keep: Keep, now: datetime, current: Path | None = None) -> Iterator[str]:
    """Remove what is too old or too much.

    Args:
        sessions: Folder of all sessions.
        keep: How long sessions are kept.
        now: Present time, UTC.
        current: The session in progress, which loses closed segments at most.

    Yields:
        A sentence for each removal.
    """
    older = [path for path in session_directories(sessions) if path != current]
    excess = _size(sessions) - keep.bytes if keep.bytes is not None else 0
    for directory in older:
        size = _size(directory)
        if excess > 0:
            cause = f"sessions take more than {(keep.bytes or 0) / 1e6:g} MB"
        elif _too_old(directory, keep, now):
            cause = f"it is older than {keep.days:g} days"
        else:
            continue
        if _remove(directory):
            excess -= size
            yield f"session {directory.name} removed: {cause}"
    if current is not None and excess > 0:
        yield from _prune_segments(current, excess)


def _prune_segments(directory: Path, excess: int) -> Iterator[str]:
    closed = [segment for segment in segments(directory) if segment.closed]
    for segment in closed:
        if excess <= 0:
            return
        excess -= segment.path.stat().st_size
        segment.path.unlink()
        yield f"{segment.path.name} of session {directory.name} removed: sessions take too much"


def _remove(directory: Path) -> bool:
    claim = SessionLock.on(directory)
    if claim is None:
        return False
    try:
        shutil.rmtree(directory)
    finally:
        claim.release()
    return True


def _too_old(directory: Path, keep: Keep, now: datetime) -> bool:
    if keep.days is None:
        return False
    try:
        started = read_info(directory).started
    except RecordingError:  # not known what it is: left for a person to look at
        return False
    return (
        now - started
    ).total_seconds() > keep.days * _DAY_S  # any number of days, without an end


def _size(directory: Path) -> int:
    return sum(path.stat().st_size for path in directory.rglob("*") if path.is_file())
