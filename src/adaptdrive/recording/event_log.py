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

_TABLES: dict[type[EventRow | CommandRow], str] = {EventRow: "events", CommandRow: "commands"}
_RENAMED = {"number": "id", "id": "command_id"}
"""Columns with another name than their field."""

_SQL = {
    "datetime": "TEXT NOT NULL",
    "str": "TEXT NOT NULL",
    "bool": "INTEGER NOT NULL",
    "int": "INTEGER NOT NULL",
    "float": "REAL",
}


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
            _insert(database, EventRow, events)
            _insert(database, CommandRow, commands)
            rows = count_rows(database)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return rows


def _insert(database: sqlite3.Connection, kind: type[T], rows: Iterable[T]) -> None:
    columns, table = _columns(kind), _TABLES[kind]
    database.execute(f"CREATE TABLE IF NOT EXISTS {table} ({', '.join(columns.values())})")
    names = ", ".join(column.split(" ")[0] for column in columns.values())
    places = ", ".join(f":{field}" for field in columns)
    command = f"INSERT OR IGNORE INTO {table} ({names}) VALUES ({places})"  # noqa: S608 - constants
    database.executemany(command, map(_values, rows))


def _columns(kind: type[EventRow | CommandRow]) -> dict[str, str]:
    """Return the columns of a table as SQL defines them, by field of its rows; the key first."""
    defined = {
        field: f"{_RENAMED.get(field, field)} {_SQL[kind.__annotations__[field]]}"
        for field in kind.__struct_fields__
    }
    return {"number": "id INTEGER PRIMARY KEY"} | defined | {"number": "id INTEGER PRIMARY KEY"}


def _values(row: EventRow | CommandRow) -> dict[str, Any]:
    time, number = row.time.isoformat(), row.number or None
    return msgspec.structs.asdict(row) | {"time": time, "number": number}


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
    return _read(path, EventRow)


def read_commands(path: Path) -> tuple[CommandRow, ...]:
    """Return all operator commands of a log; none before it was made.

    Raises:
        RecordingError: The log is damaged.
    """
    return _read(path, CommandRow)


def _read(path: Path, kind: type[T]) -> tuple[T, ...]:
    """Return the rows of a table as values, each of the type that it was recorded with.

    Args:
        path: The log.
        kind: Type of the rows.

    Raises:
        RecordingError: The log is damaged.
    """
    table = _TABLES[kind]
    names = {field: column.split(" ")[0] for field, column in _columns(kind).items()}
    try:
        return tuple(msgspec.convert(_given(row, names), kind) for row in _rows(path, table))
    except (msgspec.ValidationError, UnicodeDecodeError, OverflowError, MemoryError) as problem:
        raise RecordingError(path, f"damaged {table}: {problem}") from problem


def _given(row: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a row by the fields of its type; SQLite keeps NaN as nothing, and no truth values."""
    found = {field: row[name] for field, name in names.items() if name in row}
    if found.get("monotonic_s") is None:
        found["monotonic_s"] = math.nan
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
