"""Directories that can be written."""

from __future__ import annotations

import tempfile
from pathlib import Path


def directory_flaw(directory: Path) -> str | None:
    """Return why a directory cannot be created or written, None when it can be used."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=directory).close()
    except OSError as problem:
        return problem.strerror or str(problem)
    return None
