"""Files that are replaced whole, and directories that can be written."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def replace_regular(path: Path, content: bytes) -> None:
    """Replace a file, so that a reader sees the old one or the new one, whole.

    Args:
        path: The file.
        content: What it shall hold.

    Raises:
        OSError: The disk refuses; it names the file, which is as before.
    """
    unfinished = path.with_name(f"{path.name}.unfinished")
    try:
        unfinished.unlink(missing_ok=True)
        with unfinished.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as problem:
        unfinished.unlink(missing_ok=True)
        problem.filename = str(path)
        raise
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
