"""Reading a session back, however it ended, or while it is written."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.errors import RecordingError, reason_of
from adaptdrive.files import read_regular
from adaptdrive.recording.records import CommandRow, EventRow
from adaptdrive.recording.segments import Segment, closed_segments, segments
from adaptdrive.recording.session import (
    CONFIG_FILE,
    NO_SESSION,
    PARTS,
    SessionInfo,
    TableName,
    has_any,
    read_info,
    session_directories,
)
from adaptdrive.recording.tables import NOTE_ROWS, table_schema

_LARGEST_TEXT_BYTES = 4 << 20
"""A configuration of a million characters, the longest that is accepted."""

_INCOMPLETE = "not all of its events and commands can be read"


@dataclass(frozen=True)
class Session:
    """A recorded session; its tables are read when they are asked for.

    Attributes:
        path: Its directory.
        info: Contents of `session.json`.
        config_text: The configuration it ran with, as TOML.
        events: Events in their order.
        commands: Operator commands in their order.
        damage: Why `events` or `commands` lack some; empty otherwise.
    """

    path: Path
    info: SessionInfo
    config_text: str
    events: tuple[EventRow, ...]
    commands: tuple[CommandRow, ...]
    damage: str = ""

    @cached_property
    def ticks(self) -> pa.Table:
        """Fast ticks, all of them in memory."""
        return self._table(TableName.TICKS)

    @cached_property
    def slow(self) -> pa.Table:
        """Slow steps."""
        return self._table(TableName.SLOW)

    @cached_property
    def sensors(self) -> pa.Table:
        """Values of the sensor buses."""
        return self._table(TableName.SENSORS)

    def batches(self, table: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a table a batch at a time.

        Args:
            table: Name of the table.
            columns: The columns wanted, None for all.

        Raises:
            RecordingError: A file is damaged, or holds another table; a value of an enumeration
                that is none of it shows that, too.
        """
        for batches in self._segments(table, columns):
            yield from batches

    def ends(
        self, table: str, columns: Sequence[str]
    ) -> tuple[pa.RecordBatch, pa.RecordBatch] | None:
        """Return the first and the last rows of a table, without those between; None without rows.

        Args:
            table: Name of the table.
            columns: The columns wanted.

        Raises:
            RecordingError: As for `batches`.
        """
        first = next(self.batches(table, columns), None)
        for batches in reversed(self._segments(table, columns)):
            for last in deque(batches, maxlen=1):
                return first, last
        return None

    @property
    def last_tick(self) -> datetime | None:
        """Time of the last recorded tick, None where that is not recorded."""
        ends = self.ends(TableName.TICKS, ("utc",))
        found: datetime | None = ends and ends[1].column("utc")[-1].as_py()
        return found

    def _segments(
        self, table: str, columns: Sequence[str] | None
    ) -> list[Iterator[pa.RecordBatch]]:
        """Return the rows of each segment of a table, read when they are asked for."""
        schema = table_schema(table, self.info)
        if columns is not None:
            schema = pa.schema([schema.field(name) for name in columns])
        return [segment.rows(schema) for segment in segments(self.path, self.info, table)]

    def _table(self, table: str) -> pa.Table:
        return pa.Table.from_batches(list(self.batches(table)), table_schema(table, self.info))


def session_notes(
    directory: Path, damage: list[str] | None = None
) -> tuple[tuple[EventRow, ...], tuple[CommandRow, ...]]:
    """Return the events and commands of a session, also where its facts are lost.

    Args:
        directory: Directory of the session.
        damage: Takes what cannot be read, in words; None to refuse that.

    Raises:
        RecordingError: They are damaged.
    """
    try:
        found = segments(directory, read_info(directory))
    except RecordingError:
        found = closed_segments(directory)
    notes: dict[str, list[Any]] = {TableName.EVENTS: [], TableName.COMMANDS: []}
    for segment in found:
        try:
            if segment.table in notes:
                notes[segment.table] += _notes(segment)
        except RecordingError as problem:
            if damage is None:
                raise
            damage.append(str(problem))
    return tuple(notes[TableName.EVENTS]), tuple(notes[TableName.COMMANDS])


def _notes(segment: Segment) -> list[Any]:
    try:
        schema = table_schema(segment.table)
        rows = [row for batch in segment.rows(schema) for row in batch.to_pylist()]
        return [msgspec.convert(row, NOTE_ROWS[segment.table]) for row in rows]
    except (msgspec.ValidationError, ValueError, OverflowError) as problem:
        raise RecordingError(segment.path, f"damaged {segment.table}: {problem}") from problem


def read_session(path: Path) -> Session:
    """Read a session that has ended in any way, or is still being written.

    Damaged events and commands leave the tables readable: `Session.damage` names them.

    Args:
        path: Directory of the session.

    Raises:
        RecordingError: There is no session, or its facts or configuration are damaged.
    """
    info = read_info(path)
    damage: list[str] = []
    events, commands = session_notes(path, damage)
    return Session(
        path=path,
        info=info,
        config_text=_read_text(path / CONFIG_FILE),
        events=events,
        commands=commands,
        damage="; ".join([*damage, _INCOMPLETE]) if damage else "",
    )


def _read_text(path: Path) -> str:
    try:
        return read_regular(path, _LARGEST_TEXT_BYTES).decode()
    except OSError as problem:
        raise RecordingError(path, reason_of(problem)) from problem
    except UnicodeDecodeError as problem:
        raise RecordingError(path, str(problem)) from problem


def find_session(name: str | None, sessions: Path) -> Path:
    """Return the session that an operator names by path, or by its name in `sessions`.

    Its path ends in the name of the session also where that was given as `.` or `..`.

    Args:
        name: Path or name, None for the last session.
        sessions: Folder of the sessions.

    Raises:
        RecordingError: There is none.
    """
    if name is None:
        *_, last = (None, *session_directories(sessions))
        if last is None:
            raise RecordingError(sessions, NO_SESSION)
        return last
    for directory in (Path(name), sessions / name):
        if has_any(directory, PARTS):
            return directory if directory.name.strip(".") else directory.resolve()
    raise RecordingError(name, f"no such session, neither as a path nor in {sessions}")
