"""Files that describe a drive: read whole, and never waited for."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path
from textwrap import shorten
from typing import TypeVar

from adaptdrive.util.errors import ConfigurationError, Flaw

Parsed = TypeVar("Parsed")

_LONGEST_PROBLEM = 300
"""A parser quotes the line at fault, and a file that is no text may be one line."""


def description_text(path: Path) -> str:
    """Return the text of a DBC or EDS file, in whichever encoding its editor wrote it.

    A byte order mark decides; without one it is UTF-8, or else Windows code page 1252.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        ValueError: No file can have such a name, or the bytes contradict the byte order mark.
    """
    if not path.is_file():  # a pipe or a terminal would be waited for
        raise OSError("there is no such file" if not path.exists() else "it is no regular file")
    content = path.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def read_description(
    path: Path, source: Path | str, place: str, parse: Callable[[str], Parsed]
) -> Parsed:
    """Return what a parser makes of a file.

    Args:
        path: The file.
        source: The configuration that names it, for the error message.
        place: Where the configuration names it.
        parse: The parser.

    Raises:
        ConfigurationError: The file cannot be read or parsed.
    """
    try:
        return parse(description_text(path))
    except Exception as problem:  # parsers raise errors of many kinds
        text = shorten(str(problem) or type(problem).__name__, _LONGEST_PROBLEM, placeholder="…")
        raise ConfigurationError(
            source, [Flaw(place, f"{path} cannot be used: {text}")]
        ) from problem
