"""Marks of a session: what somebody did to the load, of which no measurement shows the time."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import msgspec

MARKS_FILE = "marks.json"


class SessionMark(msgspec.Struct, frozen=True):
    """One mark.

    Attributes:
        time: When it was done, UTC.
        text: What was done, in some words.
    """

    time: datetime
    text: str


def write_marks(session: Path, marks: Sequence[SessionMark]) -> None:
    """Write the marks of a session into its folder.

    Raises:
        OSError: The folder cannot be written.
    """
    (session / MARKS_FILE).write_bytes(msgspec.json.encode(marks))


def read_marks(session: Path) -> list[SessionMark]:
    """Return the marks of a session, none where there are none or they cannot be read."""
    try:
        content = (session / MARKS_FILE).read_bytes()
        return msgspec.json.decode(content, type=list[SessionMark])
    except (OSError, ValueError):
        return []
