"""Log lines: one JSON object a line on stderr, for the journal. Nothing is logged per tick."""

import json
import os
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Literal, TextIO

Level = Literal["info", "warning", "error"]

# sd-daemon(3): the journal takes the priority of a line from its beginning, and takes it off.
_PRIORITIES: Mapping[Level, str] = {"info": "<6>", "warning": "<4>", "error": "<3>"}


def log(level: Level, event: str, **facts: object) -> None:
    """Write one line.

    Args:
        level: How much it matters.
        event: What happened, in words.
        facts: What else is known, by name.
    """
    sys.stderr.write(f"{line(level, event, **facts)}\n")


def line(level: Level, event: str, **facts: object) -> str:
    """Return a line, with a priority where stderr is the journal; see `log`."""
    time = datetime.now(UTC).isoformat().replace("+00:00", "Z")
    entry = facts | {"event": event, "level": level, "timestamp": time}
    text = json.dumps(entry, ensure_ascii=False, default=str)
    return f"{_PRIORITIES[level]}{text}" if leads_to_journal(sys.stderr, os.environ) else text


def leads_to_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Return whether what is written to a stream goes to the journal itself.

    Args:
        stream: The stream.
        environment: Process environment, with JOURNAL_STREAM where the service manager set it.
    """
    try:
        place = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return environment.get("JOURNAL_STREAM") == f"{place.st_dev}:{place.st_ino}"
