"""Records of trips that a daemon had no time to write at its end, kept for the next start.

A file holds what the process that writes such a record reads; to keep it takes one write and
its sync.
"""

from __future__ import annotations

import contextlib
import errno
import re
from pathlib import Path

from adaptdrive.files import read_regular, replace_regular, unfinished_path
from adaptdrive.recording.session import SessionInfo, time_in_name

_PREFIX = ".left-trip-"
_NAME = re.compile(rf"{re.escape(_PREFIX)}[^_]+-(?P<number>\d+)_(?P<drive>.+)")
_LARGEST_BYTES = 32 << 20
"""Several times 70 s at full rate with the sensors of all buses."""


class DamagedTripError(OSError):
    """A kept trip will never make a record; the reason is the message."""


def left_path(sessions: Path, info: SessionInfo, number: int) -> Path:
    """Return the path of what is left of one trip.

    Args:
        sessions: Folder of all sessions.
        info: The session of the trip.
        number: Running number of its event.
    """
    return sessions / f"{_PREFIX}{time_in_name(info.started)}-{number}_{info.drive}"


def leave(path: Path, messages: bytes) -> None:
    """Keep the messages of a trip; the file appears when all of it is on disk.

    Raises:
        OSError: The disk refuses; what it took is removed.
    """
    replace_regular(path, messages)


def remove_unfinished(sessions: Path, drive: str) -> None:
    """Remove what daemons of a drive that were killed had kept of a trip in part.

    Args:
        sessions: Folder of all sessions.
        drive: Name of the drive; those of others may be in use.
    """
    for path in sessions.glob(unfinished_path(Path(f"{_PREFIX}*")).name):
        match = _NAME.fullmatch(path.stem)
        if match and match["drive"] == drive:
            with contextlib.suppress(OSError):  # it stays for another start
                path.unlink()


def read_left(path: Path) -> bytes:
    """Return the messages of a trip that was kept.

    Raises:
        DamagedTripError: It is no file of such messages: a FIFO, or far too large.
        OSError: It cannot be read.
    """
    try:
        return read_regular(path, _LARGEST_BYTES)
    except OSError as problem:
        if problem.errno in {errno.EINVAL, errno.EFBIG}:
            raise DamagedTripError(problem.strerror) from problem
        raise


def left_trips(sessions: Path, drive: str) -> list[tuple[Path, int]]:
    """Return what is left of the trips of a drive, with the number of each, the oldest first.

    Args:
        sessions: Folder of all sessions.
        drive: Name of the drive; those of others are left to their own daemons.
    """
    found = ((path, _NAME.fullmatch(path.name)) for path in sorted(sessions.glob(f"{_PREFIX}*")))
    return [
        (path, int(match["number"])) for path, match in found if match and match["drive"] == drive
    ]
