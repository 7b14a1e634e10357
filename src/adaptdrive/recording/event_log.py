"""Events and operator commands of a session in SQLite."""

from __future__ import annotations

import math
import shutil
import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from adaptdrive.errors import RecordingError, reason_of
from adaptdrive.files import require_regular
from adaptdrive.recording.records import CommandRow, EventRow

T = TypeVar("T", EventRow, CommandRow)

_TABLES = """
CREATE TABLE IF NOT EXISTS events (
    id INTEGER PRIMARY KEY,
    time TEXT NOT NULL,
    monotonic_s REAL,
    tick INTEGER NOT NULL,
    kind TEXT NOT NULL,
    severity TEXT NOT NULL,
    detail TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS commands (
    id INTEGER PRIMARY KEY,
    time TEXT NOT NULL,
    monotonic_s REAL,
    command_id TEXT NOT NULL,
    verb TEXT NOT NULL,
    value TEXT NOT NULL,
    user TEXT NOT NULL,
    accepted INTEGER NOT NULL,
    reason TEXT NOT NULL
);
"""
_INSERT_EVENT = """
INSERT OR IGNORE INTO events (id, time, monotonic_s, tick, kind, severity, detail)
VALUES (?, ?, ?, ?, ?, ?, ?)
"""
_INSERT_COMMAND = """
INSERT OR IGNORE INTO commands
(id, time, monotonic_s, command_id, verb, value, user, accepted, reason)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
"""


def append(path: Path, events: Iterable[EventRow], commands: Iterable[CommandRow]) -> int:
    """Add events and commands to a log, which is replaced as a whole.

    A row that is there already is left as it is, so that the same rows may be added again.

    Args:
        path: The log.
        events: Events in their order.
        commands: Operator commands in their order.

    Returns:
        Events and commands in it.

    Raises:
        OSError: It cannot be written.
        sqlite3.Error: The log that is there is damaged, or the disk is full.
    """
    unfinished = path.with_name(f"{path.name}.unfinished")
    try:
        if path.exists():
            shutil.copyfile(path, unfinished)
        with closing(sqlite3.connect(unfinished)) as database, database:
            database.executescript(_TABLES)
            database.executemany(_INSERT_EVENT, map(_event_values, events))
            database.executemany(_INSERT_COMMAND, map(_command_values, commands))
            rows = count_rows(database)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return rows


def count_rows(database: sqlite3.Connection) -> int:
    """Return the number of events and commands in the database of a log."""
    (rows,) = database.execute(
        "SELECT (SELECT count(*) FROM events) + (SELECT count(*) FROM commands)"
    ).fetchone()
    return int(rows)


@dataclass(frozen=True, slots=True)
class LogContents:
    """Contents of a log, as far as they can be read.

    Attributes:
        events: Events in their order.
        commands: Operator commands in their order.
        damage: Path of the log and its damage; empty for a sound one.
    """

    events: tuple[EventRow, ...] = ()
    commands: tuple[CommandRow, ...] = ()
    damage: str = ""


def read_events(path: Path) -> tuple[EventRow, ...]:
    """Return all events of a log; none before it was made.

    Raises:
        RecordingError: The log is damaged.
    """
    return _read(path, "events", EventRow, {"number": "id"})


def read_commands(path: Path) -> tuple[CommandRow, ...]:
    """Return all operator commands of a log; none before it was made.

    Raises:
        RecordingError: The log is damaged.
    """
    return _read(path, "commands", CommandRow, {"number": "id", "id": "command_id"})


def _read(path: Path, table: str, kind: type[T], columns: Mapping[str, str]) -> tuple[T, ...]:
    """Return the rows of a table as values, each of the type that it was recorded with.

    Args:
        path: The log.
        table: Name of the table.
        kind: Type of the rows.
        columns: Name of a field's column, where it is another one.

    Raises:
        RecordingError: The log is damaged.
    """
    names = {field: columns.get(field, field) for field in kind.__struct_fields__}
    try:
        return tuple(msgspec.convert(_given(row, names), kind) for row in _rows(path, table))
    except (msgspec.ValidationError, UnicodeDecodeError, OverflowError, MemoryError) as problem:
        raise RecordingError(path, f"damaged {table}: {problem}") from problem


def _given(row: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a row by the fields of its type."""
    found = {field: row[name] for field, name in names.items() if name in row}
    found["monotonic_s"] = _float(found.get("monotonic_s"))
    if "accepted" in found:
        found["accepted"] = bool(found["accepted"])
    return found


def _rows(path: Path, table: str) -> list[dict[str, Any]]:
    try:
        require_regular(path)
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
            database.row_factory = sqlite3.Row
            query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"
            if database.execute(query, (table,)).fetchone() is None:
                return []
            found = database.execute(f"SELECT * FROM {table} ORDER BY id")  # noqa: S608 - a constant
            return [dict(row) for row in found]
    except FileNotFoundError:
        return []
    except OSError as problem:
        raise RecordingError(path, reason_of(problem)) from problem
    except sqlite3.Error as problem:
        raise RecordingError(path, str(problem)) from problem


def _event_values(event: EventRow) -> tuple[Any, ...]:
    time, monotonic_s = event.time.isoformat(), event.monotonic_s
    number = event.number or None
    return (number, time, monotonic_s, event.tick, event.kind, event.severity, event.detail)


def _command_values(command: CommandRow) -> tuple[Any, ...]:
    return (
        command.number or None,
        command.time.isoformat(),
        command.monotonic_s,
        command.id,
        command.verb,
        command.value,
        command.user,
        command.accepted,
        command.reason,
    )


def _float(value: float | None) -> float:
    return math.nan if value is None else value
