"""Tables in files of the log."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
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
_KINDS: dict[str, tuple[Kind, Any]] = {
    TICKS: (Kind.TICKS, Ticks),
    SLOW: (Kind.SLOW, list[dict[str, Any]]),
    SENSORS: (Kind.SENSORS, list[dict[str, Any]]),
    EVENTS: (Kind.EVENT, NOTE_ROWS[EVENTS]),
    COMMANDS: (Kind.COMMAND, NOTE_ROWS[COMMANDS]),
}
"""Kind and contents of the records of each table."""


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
    kind, contents = _KINDS[table]
    timed: list[tuple[Any, float]] = []
    rows = 0
    for record in records(files, losses):
        found = content_of(record, contents, losses) if record.kind is kind else None
        if found is None:
            continue
        if table in NOTE_ROWS:
            found = [msgspec.structs.asdict(found)]
        timed.append((found, record.wall_s - record.monotonic_s))
        rows += found.rows if isinstance(found, Ticks) else len(found)
        if rows >= (_TICKS_AT_ONCE if table == TICKS else _ROWS_AT_ONCE):
            yield from _made(timed, table, schema, losses)
            timed, rows = [], 0
    if rows:
        yield from _made(timed, table, schema, losses)


def _made(
    timed: Sequence[tuple[Any, float]], table: str, schema: pa.Schema, losses: list[str]
) -> Iterator[pa.RecordBatch]:
    """Yield a batch, or note that its rows do not fit their table, as those of another version."""
    try:
        yield ticks_batch(timed, schema) if table == TICKS else rows_batch(timed, schema)
    except (LookupError, TypeError, ValueError, OverflowError) as problem:
        losses.append(f"rows that make no table: {problem}")


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
