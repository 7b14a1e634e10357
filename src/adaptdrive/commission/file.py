"""The configuration file with new values: comments stay, and the old file is kept."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from adaptdrive.errors import ConfigurationError, Flaw


def with_values(text: str, values: Mapping[str, float | int]) -> str:
    """Return a TOML document with new values, its comments and order as before.

    Args:
        text: The document.
        values: New values by dotted key; a missing table is made.
    """
    document = tomlkit.parse(text)
    for key, value in values.items():
        *path, name = key.split(".")
        table: Any = document
        for part in path:
            table = table.setdefault(part, tomlkit.table())
        table[name] = value
    return tomlkit.dumps(document)


def write_values(path: Path, text: str) -> Path:
    """Replace a file at once, after a copy of it was made.

    Args:
        path: The file.
        text: Its new content.

    Returns:
        The copy.

    Raises:
        ConfigurationError: The file or its copy cannot be written.
    """
    backup = path.with_name(f"{path.name}.bak")
    try:
        shutil.copy2(path, backup)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        shutil.copymode(path, name)
        Path(name).replace(path)
    except OSError as problem:
        raise ConfigurationError(path, [Flaw("file", f"cannot be written: {problem}")]) from problem
    return backup
