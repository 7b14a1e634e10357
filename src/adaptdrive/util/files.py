"""Small files: read without waiting for anything, a FIFO or a device is refused; replaced whole."""

import contextlib
import errno
import fcntl
import os
import secrets
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from adaptdrive.util.errors import reason_of

_LARGEST_BYTES = 1 << 20
"""Four times a bundle of all public certificate authorities, the largest of these files."""

_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFDIR: "a directory",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def read_regular(path: Path, largest: int = _LARGEST_BYTES) -> bytes:
    """Return the bytes of a regular file.

    Args:
        path: The file.
        largest: Bytes that it may have.

    Raises:
        FileNotFoundError: There is nothing.
        OSError: It cannot be read, or is no regular file of a sensible size.
    """
    # without O_NONBLOCK the open of a FIFO waits for a writer
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        found = os.fstat(descriptor)
        _require_regular(found.st_mode, path)
        if found.st_size > largest:
            raise OSError(errno.EFBIG, f"it has {found.st_size} bytes", str(path))
        return os.read(descriptor, largest)
    finally:
        os.close(descriptor)


def require_regular(path: Path) -> None:
    """Refuse what other code would wait for when it opens it.

    Args:
        path: The file.

    Raises:
        OSError: It is no regular file, or cannot be found.
    """
    _require_regular(path.stat().st_mode, path)


def replace_regular(path: Path, content: bytes) -> None:
    """Replace a file, so that a reader sees the old one or the new one, whole.

    Args:
        path: The file.
        content: What it shall hold.

    Raises:
        OSError: The disk refuses; it names the file, which is as before.
    """
    # the same name each time: what a process that was killed has left there is replaced
    _replace(path, content, path.with_name(f"{path.name}.unfinished"))


def replace_result(path: Path, content: bytes) -> None:
    """Replace a file that two commands may make at once; the later one's stays, whole.

    Args:
        path: The file.
        content: What it shall hold.

    Raises:
        OSError: The disk refuses; it names the file, which is as before.
    """
    _replace(path, content, path.with_name(f".unfinished-{secrets.token_hex(8)}"))


def _replace(path: Path, content: bytes, unfinished: Path) -> None:
    try:
        unfinished.unlink(missing_ok=True)
        with unfinished.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as problem:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        problem.filename, problem.filename2 = str(path), None
        raise
    _sync_directory(path.parent)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep every other process that asks for the same out of a folder.

    Raises:
        OSError: The folder cannot be opened.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _sync_directory(directory: Path) -> None:
    """Make a rename outlast a power cut."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _require_regular(mode: int, path: Path) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))


def directory_flaw(directory: Path) -> str | None:
    """Return why a directory cannot be created or written, None when it can be used."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
    except OSError as problem:
        return reason_of(problem)
    return None
