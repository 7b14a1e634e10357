"""Reading a session back, however it ended, or while it is written."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from adaptdrive.errors import RecordingError, reason_of
from adaptdrive.files import read_regular
from adaptdrive.recording.notes import session_notes
from adaptdrive.recording.records import CommandRow, EventRow
from adaptdrive.recording.segments import Segment, segments
from adaptdrive.recording.session import (
    CONFIG_FILE,
    SENSORS,
    SLOW,
    TICKS,
    SessionInfo,
    read_info,
)
from adaptdrive.recording.tables import conform, table_schema

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
        return self._table(TICKS)

    @cached_property
    def slow(self) -> pa.Table:
        """Slow steps."""
        return self._table(SLOW)

    @cached_property
    def sensors(self) -> pa.Table:
        """Values of the sensor buses."""
        return self._table(SENSORS)

    def schema(self, table: str) -> pa.Schema:
        """Return the columns of a table, with their units."""
        if table != SENSORS:
            return table_schema(table, self.info.output_unit)
        found = [segment.schema() for segment in segments(self.path, self.info, table)]
        return pa.unify_schemas(found) if found else pa.schema([])

    def batches(self, table: str, columns: Sequence[str] | None = None) -> Iterator[pa.RecordBatch]:
        """Yield the rows of a table a batch at a time.

        Args:
            table: Name of the table.
            columns: The columns wanted, None for all.

        Raises:
            RecordingError: A file is damaged, or holds another table; a value of an enumeration
                that is none of it shows that, too.
        """
        schema = self._schema_of(table, columns)
        for segment in segments(self.path, self.info, table):
            yield from _rows(segment, schema)

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
        schema, found = self._schema_of(table, columns), segments(self.path, self.info, table)
        for segment in found:
            if (first := next(_filled(segment, schema), None)) is not None:
                lasts = (_last(_filled(one, schema)) for one in reversed(found))
                return first, next(last for last in lasts if last is not None)
        return None

    @property
    def last_tick(self) -> datetime | None:
        """Time of the last recorded tick, None where that is not recorded."""
        ends = self.ends(TICKS, ("utc",))
        found: datetime | None = ends and ends[1].column("utc")[-1].as_py()
        return found

    def _schema_of(self, table: str, columns: Sequence[str] | None) -> pa.Schema:
        schema = self.schema(table)
        if columns is None:
            return schema
        return pa.schema([schema.field(name) for name in columns])

    def _table(self, table: str) -> pa.Table:
        return pa.Table.from_batches(list(self.batches(table)), self.schema(table))


def conformed(segment: Segment, batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return rows of a segment as those of its table.

    Args:
        segment: The segment, for the text of an error.
        batch: Rows of it.
        schema: The columns wanted.

    Raises:
        RecordingError: They are damaged, or rows of another table.
    """
    try:
        return conform(batch, schema)
    except ValueError as problem:
        raise RecordingError(segment.path, str(problem)) from problem


def _rows(segment: Segment, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    return (conformed(segment, batch, schema) for batch in segment.batches(schema.names))


def _filled(segment: Segment, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    return (batch for batch in _rows(segment, schema) if batch.num_rows)


def _last(batches: Iterator[pa.RecordBatch]) -> pa.RecordBatch | None:
    return next(iter(deque(batches, maxlen=1)), None)


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
