"""Files that describe a drive: read whole, and never waited for."""

from __future__ import annotations

from pathlib import Path

_LARGEST_BYTES = 16 * 1024 * 1024
"""Larger than any maker's file, and small enough to be parsed."""


def read_description(path: Path) -> bytes:
    """Return the content of a DBC or EDS file.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be read, is no regular file, or is too large.
        ValueError: No file can have such a name.
    """
    if not path.is_file():  # a pipe or a terminal would be waited for
        raise OSError("there is no such file" if not path.exists() else "it is no regular file")
    if path.stat().st_size > _LARGEST_BYTES:
        raise OSError(f"it has more than {_LARGEST_BYTES} bytes")
    return path.read_bytes()


def problem_text(problem: Exception) -> str:
    """Return an error in one line."""
    text = " ".join(str(problem).split())
    return text or type(problem).__name__
