"""Sessions whose recorder vanished: closed at the next start, and reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import msgspec

from adaptdrive.errors import RecordingError
from adaptdrive.recording.event_log import tidy
from adaptdrive.recording.housekeeping import ERRORS
from adaptdrive.recording.resume import find_written
from adaptdrive.recording.segments import segments
from adaptdrive.recording.session import (
    EVENTS_FILE,
    TICKS,
    Ending,
    SessionInfo,
    SessionLock,
    read_info,
    session_directories,
    write_info,
)

_UNTIDY = {Ending.CUT, Ending.LOST}


def repair(sessions: Path, current: Path, drive: str, ending: Callable[[], bool]) -> Iterator[str]:
    """Close the sessions whose recorder has died.

    Args:
        sessions: Folder of all sessions.
        current: The session that is being written.
        drive: Name of its drive; others may share the folder.
        ending: Returns True to have the rest left for another time.

    Yields:
        A sentence for each session that was lost, for the drive's one before this if it was cut,
        and for each that cannot be read or written, which keeps no other from being closed.
    """
    older = [path for path in session_directories(sessions) if path != current]
    last = _last_of(older, drive)
    for directory in older:
        if ending():
            return
        try:
            yield from _closed(directory, last=directory == last)
        except ERRORS as problem:
            yield f"session {directory.name} is left as it is: {problem}"


def _last_of(directories: list[Path], drive: str) -> Path | None:
    """Return the newest session of a drive, None where none can be read."""
    for directory in reversed(directories):
        with suppress(RecordingError):
            if read_info(directory).drive == drive:
                return directory
    return None


def _closed(directory: Path, *, last: bool) -> Iterator[str]:
    """Close one session; yield a sentence if it was lost, or if it is the last one and was cut."""
    info = read_info(directory)
    if info.ended is Ending.OPEN:
        info = close_lost(directory) or info
        if info.ended is Ending.LOST:
            yield _sentence(directory, info)
    elif last and info.ended in _UNTIDY:
        yield _sentence(directory, info)
    close_segments(directory)


def close_lost(directory: Path) -> SessionInfo | None:
    """Mark an open session as lost; None when its writer is alive.

    Raises:
        RecordingError, OSError: It cannot be read or written.
    """
    claim = SessionLock.on(directory)
    if claim is None:
        return None
    try:
        info = read_info(directory)
        if info.ended is Ending.OPEN:
            found = find_written(directory, info)
            histograms = found.times.histograms
            info = msgspec.structs.replace(
                info, ended=Ending.LOST, histograms=histograms, rows=found.rows
            )
            write_info(directory, info)
        return info
    finally:
        claim.release()


def close_segments(directory: Path) -> None:
    """Turn the streams that a session has left into Parquet, and merge its log of events."""
    claim = SessionLock.on(directory)
    if claim is None:
        return
    try:
        for segment in segments(directory):
            segment.close()
        tidy(directory / EVENTS_FILE)
    finally:
        claim.release()


def last_tick_time(directory: Path) -> datetime | None:
    """Return when the last recorded tick was, None where that is not recorded."""
    for segment in reversed(segments(directory, TICKS)):
        found: datetime | None = None
        for batch in segment.batches(["utc"]):
            if "utc" in batch.schema.names and batch.num_rows:
                found = batch.column("utc")[-1].as_py()
        if found is not None:
            return found
    return None


def _sentence(directory: Path, info: SessionInfo) -> str:
    last = last_tick_time(directory)
    end = f"its last tick is of {last:%Y-%m-%dT%H:%M:%S.%f}Z" if last else "it holds no ticks"
    how = "the daemon vanished" if info.ended is Ending.CUT else "daemon and recorder vanished"
    return f"session {directory.name} ended without its close, {how}: {end}"
