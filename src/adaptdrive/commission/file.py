"""The configuration file with new values: other comments stay, and the old file is kept."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from itertools import chain, count
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from adaptdrive.config.file import read_text
from adaptdrive.util.errors import ConfigurationError, Flaw

ORIGIN = "by adaptdrive commission"


def with_values(path: Path, text: str, values: Mapping[str, float | int]) -> str:
    """Return a TOML document with new values, in its order.

    A comment with a figure after a value that changes goes: it describes the old value.

    Args:
        path: The file that it is from.
        text: The document.
        values: New values by dotted key; a missing table is made.

    Raises:
        ConfigurationError: The document cannot be changed: its tables are too scattered.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as problem:  # of some documents that are valid, too
        flaw = f"cannot be changed: {problem}; write the parts of each table one after another"
        raise ConfigurationError(path, [Flaw("file", flaw)]) from problem
    for key, value in values.items():
        *tables, name = key.split(".")
        table: Any = document
        for part in tables:
            table = table.setdefault(part, tomlkit.table())
        old = table.get(name)
        if old != value:
            stays = old is not None and not re.search(r"\d", old.trivia.comment)
            table[name] = value if stays else tomlkit.item(value).comment(ORIGIN)
    return tomlkit.dumps(document)


def write_values(path: Path, text: str) -> Path:
    """Replace a file at once, after a copy of it was made; its owner and its rights stay.

    Args:
        path: The file; where it is a symbolic link, the file that the link leads to is replaced.
        text: Its new content.

    Returns:
        The copy.

    Raises:
        ConfigurationError: The file or its copy cannot be written, or its owner cannot be kept.
    """
    try:
        file = path.resolve(strict=True)
        backup = _free_backup(file)
        _replace(backup, file.read_bytes(), like=file)
        _replace(file, text.encode("utf-8"), like=file)
    except OSError as problem:
        raise _unwritable(path, problem) from problem
    return backup


def _free_backup(file: Path) -> Path:
    """Return the path of a copy: what an earlier copy holds may be nowhere else."""
    names = (f"{file.name}.bak{number}" for number in chain([""], count(2)))
    return next(path for path in map(file.with_name, names) if not os.path.lexists(path))


def refuse_unwritable(path: Path) -> None:
    """Make sure that a file can be changed and replaced; it is as before.

    Raises:
        ConfigurationError: It cannot.
    """
    with_values(path, read_text(path), {})
    try:
        file = path.resolve(strict=True)
        _written(file, file.read_bytes(), like=file).unlink()
    except OSError as problem:
        raise _unwritable(path, problem) from problem


def _unwritable(path: Path, problem: OSError) -> ConfigurationError:
    return ConfigurationError(path, [Flaw("file", f"cannot be written: {problem}")])


def _replace(file: Path, content: bytes, like: Path) -> None:
    """Replace a file by one with the owner, group and rights of another."""
    new = _written(file, content, like)
    try:
        new.replace(file)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def _written(file: Path, content: bytes, like: Path) -> Path:
    """Write a file next to another, with the owner, group and rights of a third, and return it."""
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            owner = like.stat()
            os.fchown(stream.fileno(), owner.st_uid, owner.st_gid)
            shutil.copystat(like, name)  # access control lists, too
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise
    return Path(name)
