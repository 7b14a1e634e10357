"""Directories that can be written."""

from __future__ import annotations

import tempfile
from pathlib import Path

from adaptdrive.errors import reason_of


def directory_flaw(directory: Path) -> str | None:
    """Return why a directory cannot be created or written, None when it can be used."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
    except OSError as problem:
        return reason_of(problem)
    return None
