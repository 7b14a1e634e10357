"""Disk space set aside for a full disk: the end of a session, and the record of a trip."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

from adaptdrive.files import require_regular

_FILE = ".reserve"
_BYTES = 2 << 20
"""Two records of a trip, each of 70 s at full rate."""


def set_aside(folder: Path) -> None:
    """Occupy the reserve, where that is not done yet.

    Raises:
        OSError: There is too little space for the reserve and as much again to record into, or
            something that is no file has its name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, held = folder / _FILE, 0
    if path.exists():
        require_regular(path)
        held = path.stat().st_size
    if held >= _BYTES:
        return
    if shutil.disk_usage(folder).free < 2 * _BYTES - held:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    with path.open("ab") as file:
        os.posix_fallocate(file.fileno(), 0, _BYTES)


def release(folder: Path) -> None:
    """Give the reserve back to the disk."""
    (folder / _FILE).unlink(missing_ok=True)


def is_full(problem: BaseException) -> bool:
    """Return whether an error means that the disk or a quota is full."""
    return isinstance(problem, OSError) and problem.errno in {errno.ENOSPC, errno.EDQUOT}
