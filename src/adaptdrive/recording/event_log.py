"""Events of a session in SQLite."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable
from contextlib import closing
from datetime import datetime
from pathlib import Path

from adaptdrive.errors import RecordingError
from adaptdrive.recording.batches import EventRow

_TABLE = """
CREATE TABLE IF NOT EXISTS events (
    id INTEGER PRIMARY KEY,
    time TEXT NOT NULL,
    tick INTEGER NOT NULL,
    kind TEXT NOT NULL,
    severity TEXT NOT NULL,
    detail TEXT NOT NULL
)
"""
_INSERT = "INSERT INTO events (time, tick, kind, severity, detail) VALUES (?, ?, ?, ?, ?)"
_SELECT = "SELECT time, tick, kind, severity, detail FROM events ORDER BY id"


class EventLog:
    """Appends events; each call is one transaction."""

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(path)
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute(_TABLE)

    def append(self, events: Iterable[EventRow]) -> None:
        """Append events in their order."""
        with self._database:
            self._database.executemany(_INSERT, [_values(event) for event in events])

    def close(self) -> None:
        """Leave one plain file behind, which a read-only disk can serve too."""
        self._database.execute("PRAGMA journal_mode=DELETE")
        self._database.close()


def read_events(path: Path) -> tuple[EventRow, ...]:
    """All events of a log; none when the session broke off before it was made.

    Raises:
        RecordingError: The log is damaged.
    """
    if not path.exists():
        return ()
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            rows = database.execute(_SELECT).fetchall() if _has_table(database) else []
    except sqlite3.Error as problem:
        raise RecordingError(path, str(problem)) from problem
    return tuple(EventRow(datetime.fromisoformat(time), *rest) for time, *rest in rows)


def _has_table(database: sqlite3.Connection) -> bool:
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'events'"
    return database.execute(query).fetchone() is not None


def _values(event: EventRow) -> tuple[str, int, str, str, str]:
    return (event.time.isoformat(), event.tick, event.kind, event.severity, event.detail)
