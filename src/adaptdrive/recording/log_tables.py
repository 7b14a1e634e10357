"""Tables in files of the log."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.errors import NOT_JSON
from adaptdrive.recording.frames import ROW_KINDS, Kind, Record
from adaptdrive.recording.log_files import LogFile, records
from adaptdrive.recording.records import Ticks
from adaptdrive.recording.session import COMMANDS, EVENTS, SENSORS, SLOW, TICKS
from adaptdrive.recording.tables import NOTE_ROWS, rows_batch, ticks_batch

_TICKS_AT_ONCE = 5_000
_ROWS_AT_ONCE = 200
"""Rows of a batch: as Python values they take many times their size on disk."""
_KINDS = {
    SLOW: Kind.SLOW,
    SENSORS: Kind.SENSORS,
    EVENTS: Kind.EVENT,
    COMMANDS: Kind.COMMAND,
}


def logged_batches(
    files: Sequence[LogFile], table: str, schema: pa.Schema, losses: list[str] | None = None
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a table in files of the log.

    Args:
        files: Files of one segment of a session, in their order.
        table: Name of the table.
        schema: Its columns.
        losses: Takes what cannot be read, in words.

    Raises:
        RecordingError: A file cannot be read at all.
    """
    losses = [] if losses is None else losses
    found = records(files, losses)
    return _ticks(found, schema, losses) if table == TICKS else _rows(found, table, schema, losses)


def _ticks(
    found: Iterator[Record], schema: pa.Schema, losses: list[str]
) -> Iterator[pa.RecordBatch]:
    columns: dict[str, Any] = {}
    offsets: list[tuple[int, float]] = []
    rows = 0
    for record in found:
        ticks = content_of(record, Ticks, losses) if record.kind is Kind.TICKS else None
        if ticks is None:
            continue
        for name, values in ticks.columns.items():
            if name in columns:
                columns[name] += values
            else:
                columns[name] = list(values) if isinstance(values, list) else bytearray(values)
        offsets.append((ticks.rows, record.wall_s - record.monotonic_s))
        rows += ticks.rows
        if rows >= _TICKS_AT_ONCE:
            yield from _made(partial(ticks_batch, columns, rows, schema, offsets), losses)
            columns, offsets, rows = {}, [], 0
    if rows:
        yield from _made(partial(ticks_batch, columns, rows, schema, offsets), losses)


def _rows(
    found: Iterator[Record], table: str, schema: pa.Schema, losses: list[str]
) -> Iterator[pa.RecordBatch]:
    rows: list[dict[str, Any]] = []
    for record in found:
        if record.kind is not _KINDS[table]:
            continue
        offset = {"offset_s": record.wall_s - record.monotonic_s}
        rows += [row | offset for row in _plain_rows(record, table, losses)]
        if len(rows) >= _ROWS_AT_ONCE:
            yield from _made(partial(rows_batch, rows, schema), losses)
            rows = []
    if rows:
        yield from _made(partial(rows_batch, rows, schema), losses)


def _made(make: Callable[[], pa.RecordBatch], losses: list[str]) -> Iterator[pa.RecordBatch]:
    """Yield a batch, or note that its rows do not fit their table, as those of another version."""
    try:
        yield make()
    except (LookupError, TypeError, ValueError, OverflowError) as problem:
        losses.append(f"rows that make no table: {problem}")


def _plain_rows(record: Record, table: str, losses: list[str]) -> list[dict[str, Any]]:
    """Return the rows of a record by name of their column."""
    if table not in NOTE_ROWS:
        return content_of(record, list[dict[str, Any]], losses) or []
    note = content_of(record, NOTE_ROWS[table], losses)
    return [] if note is None else [msgspec.structs.asdict(note)]


def content_of(record: Record, kind: type[Any], losses: list[str]) -> Any:  # noqa: ANN401 - of a kind
    """Return what a record holds, None where it cannot be decoded.

    Args:
        record: The record.
        kind: Type of its contents.
        losses: Takes what cannot be read, in words.
    """
    try:
        packed = record.kind in ROW_KINDS
        payload = zlib.decompress(record.payload) if packed else record.payload
        return msgspec.msgpack.decode(payload, type=kind)
    except (zlib.error, *NOT_JSON) as problem:
        losses.append(f"record {record.number}: {problem}")
        return None
