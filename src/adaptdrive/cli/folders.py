"""Folders that commands write their files to."""

from __future__ import annotations

from pathlib import Path

from adaptdrive.app.directory import directory_flaw
from adaptdrive.errors import ConfigurationError, Flaw


def refuse_unwritable(folder: Path) -> None:
    """Refuse a folder that takes no file, before anything long is begun; make a missing one.

    Args:
        folder: The folder that the result goes to.

    Raises:
        ConfigurationError: It cannot be made or written.
    """
    if (flaw := directory_flaw(folder)) is not None:
        raise ConfigurationError("--into", [Flaw(str(folder), f"cannot be written: {flaw}")])
