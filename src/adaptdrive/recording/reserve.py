"""Disk space set aside for a full disk: the end of a session, and the record of a trip."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from pathlib import Path

from adaptdrive.files import require_regular

_FILE = ".reserve"
_BYTES = 2 << 20
"""Two records of a trip, each of 70 s at full rate."""


def set_aside(sessions: Path) -> None:
    """Occupy the reserve, where that is not done yet.

    Raises:
        OSError: There is too little space for the reserve and as much again to record into, or
            something that is no file has its name.
    """
    path = sessions / _FILE
    held = 0
    if path.exists():
        require_regular(path)
        held = path.stat().st_size
    if shutil.disk_usage(sessions).free < 2 * _BYTES - held:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(sessions))
    if held < _BYTES:
        with path.open("ab") as file:
            os.posix_fallocate(file.fileno(), 0, _BYTES)


def release(sessions: Path) -> None:
    """Give the reserve back to the disk."""
    (sessions / _FILE).unlink(missing_ok=True)


def is_full(problem: BaseException) -> bool:
    """Return whether an error means that the disk or a quota is full."""
    if isinstance(problem, sqlite3.Error):
        return getattr(problem, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
    return isinstance(problem, OSError) and problem.errno in {errno.ENOSPC, errno.EDQUOT}
