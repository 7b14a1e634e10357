"""Small files of the daemon's state: read and replaced without ever waiting for anybody.

Whatever lies in place of a file, a FIFO, a directory, a file of another user, it costs what the
file would have told and nothing else.
"""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from pathlib import Path

_LARGEST_BYTES = 1 << 20
"""A thousand times the size of any such file."""

_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def read_regular(path: Path) -> bytes:
    """The bytes of a regular file.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: There is nothing.
        OSError: It cannot be read, or is no regular file of a sensible size.
    """
    # without O_NONBLOCK the open of a FIFO waits for a writer
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
            raise OSError(errno.EINVAL, f"it is {kind}, not a file")
        if found.st_size > _LARGEST_BYTES:
            raise OSError(errno.EFBIG, f"it has {found.st_size} bytes")
        return os.read(descriptor, _LARGEST_BYTES)
    finally:
        os.close(descriptor)


def replace_regular(path: Path, content: bytes) -> None:
    """Replace a file, so that a reader sees the old one or the new one, whole.

    Args:
        path: The file.
        content: What it shall hold.

    Raises:
        OSError: The disk refuses.
    """
    unfinished = path.with_name(f"{path.name}.unfinished")
    unfinished.unlink(missing_ok=True)
    with unfinished.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)
    _sync_directory(path.parent)


def directory_flaw(directory: Path) -> str | None:
    """Return why a directory cannot be created or written, None when it can be used."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
    except OSError as problem:
        return problem.strerror or str(problem)
    return None


def _sync_directory(directory: Path) -> None:
    """Make a rename outlast a power cut."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
