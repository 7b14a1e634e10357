"""Tables on disk: Arrow schemas that explain themselves, and the Parquet files of a session.

Each field has `unit`, `description` and `source` as metadata.
"""

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
from pyarrow import parquet as pq

from adaptdrive.recording.records import CommandRow, EventRow, Ticks
from adaptdrive.recording.session import SensorColumn, SessionInfo, TableName
from adaptdrive.runtime.reports import MONOTONIC, SLOW_COLUMNS, TICK_COLUMNS
from adaptdrive.util import files, quantity
from adaptdrive.util.errors import RecordingError

# Tables on disk: Arrow schemas that explain themselves, and record batches that fit them.

UTC = pa.timestamp("us", "UTC")

INPUT_UNIT = "unit of the load's input"

_ESTIMATE = pa.struct([("name", pa.string()), ("value", pa.float64()), ("std", pa.float64())])
_TYPES: dict[type, pa.DataType] = {
    float: pa.float64(),
    int: pa.int64(),
    bool: pa.bool_(),
    str: pa.dictionary(pa.int32(), pa.string()),
    tuple: pa.list_(pa.float64()),
    dict: pa.list_(_ESTIMATE),
}
NOTE_ROWS: dict[str, type[msgspec.Struct]] = {
    TableName.EVENTS: EventRow,
    TableName.COMMANDS: CommandRow,
}
"""Rows of the tables that a session keeps for as long as it exists."""

_NOTE_TYPES: dict[object, pa.DataType] = _TYPES | {str: pa.string(), datetime: UTC}
_NOTE_TYPES[str | None] = pa.string()
_CHOICES = {one.name: one.choices for one in (*TICK_COLUMNS, *SLOW_COLUMNS) if one.choices}


def _field(column: quantity.Column | SensorColumn, kind: pa.DataType, unit: str) -> pa.Field:
    about = {"unit": unit, "description": column.meaning, "source": column.source}
    return pa.field(column.name, kind, metadata=about)


_UTC = SensorColumn("utc", "", "wall-clock time of the row, UTC", f"{MONOTONIC} + offset")
_MONOTONIC = SensorColumn(MONOTONIC, "s", "monotonic time of the row", "daemon")
_MONOTONIC_FIELD = _field(_MONOTONIC, pa.float64(), "s")


def table_schema(table: str, info: SessionInfo | None = None) -> pa.Schema:
    """Return the columns of a table.

    Args:
        table: Name of the table.
        info: Facts about the session, which has the unit of the output and the sensors.
    """
    if table in NOTE_ROWS:
        found = msgspec.structs.fields(NOTE_ROWS[table])
        return pa.schema([(field.name, _NOTE_TYPES[field.type]) for field in found])
    if table == TableName.SENSORS:
        sensors = (_MONOTONIC, *(info.sensors if info else ()))
        fields = [_field(one, pa.float64(), one.unit) for one in sensors]
    else:
        given = info.manipulated if info else quantity.BOOST
        units = {"y": info.output_unit if info else "", "u": INPUT_UNIT, "v": given.unit}
        columns = TICK_COLUMNS if table == TableName.TICKS else SLOW_COLUMNS
        fields = [_field(one, _TYPES[one.kind], units.get(one.unit, one.unit)) for one in columns]
    return pa.schema([_field(_UTC, UTC, ""), *fields])


def batch_of(table: str, timed: Sequence[tuple[Any, float]], schema: pa.Schema) -> pa.RecordBatch:
    """Return rows as a record batch; a value that a row lacks is null.

    Args:
        table: Name of their table.
        timed: Packed ticks, or lists of rows by name of their columns, each with UTC minus
            monotonic time in seconds.
        schema: The columns wanted.
    """
    if table == TableName.TICKS:
        return _ticks_batch(timed, schema)
    found = ((row, offset_s) for rows, offset_s in timed for row in rows)
    rows = [row | {"utc": _utc(row[MONOTONIC], offset_s)} for row, offset_s in found]
    return pa.RecordBatch.from_pylist(rows, schema=schema)


def _ticks_batch(timed: Sequence[tuple[Ticks, float]], schema: pa.Schema) -> pa.RecordBatch:
    rows = sum(ticks.rows for ticks, _ in timed)
    arrays = {
        field.name: _array(field.type, [ticks.columns[field.name] for ticks, _ in timed], rows)
        for field in (_MONOTONIC_FIELD, *schema)
        if field.name != "utc"
    }
    offsets = (offset_s for ticks, offset_s in timed for _ in range(ticks.rows))
    arrays["utc"] = pa.array(map(_utc, arrays[MONOTONIC].to_pylist(), offsets), UTC)
    return pa.RecordBatch.from_arrays([arrays[name] for name in schema.names], schema=schema)


def conform(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return the columns of a schema from a batch.

    Args:
        batch: Rows as they are on disk.
        schema: The columns wanted.

    Raises:
        ValueError: They are damaged, or rows of another table, in words.
    """
    if not set(batch.schema.names) & set(schema.names):
        raise ValueError("its columns are not those known here")
    try:
        columns = (batch.column(field.name) for field in schema)
        arrays = [
            found if found.type == field.type else found.cast(field.type)
            for field, found in zip(schema, columns, strict=True)
        ]
    except (pa.ArrowException, KeyError) as problem:  # of another type, or there twice
        raise ValueError(f"a column is damaged: {problem}") from problem
    rows = pa.RecordBatch.from_arrays(arrays, schema=schema)
    for name in _CHOICES.keys() & set(schema.names):
        column = rows.column(name)
        # without `unique`, for which Arrow loads a large library
        for value in (*column.dictionary.to_pylist(), *([None] if column.null_count else [])):
            if value not in _CHOICES[name]:
                choices = ", ".join(_CHOICES[name])
                flaw = f"{name} is {value!r}, which is none of {choices}"
                raise ValueError(f"it is damaged, or of another table: {flaw}")
    return rows


def _utc(time_s: float, offset_s: float) -> int | None:
    """Return a time in microseconds since 1970, None where it is not known."""
    return round((time_s + offset_s) * 1e6) if math.isfinite(time_s) else None


def _array(kind: pa.DataType, parts: list[Any], rows: int) -> pa.Array:
    """Return a column; without `cast`, for which Arrow loads a large library."""
    if isinstance(parts[0], list):
        return pa.array(chain.from_iterable(parts), kind)
    values = b"".join(parts)
    if kind == pa.bool_():
        return pa.array(map(bool, values), kind)
    return pa.Array.from_buffers(kind, rows, [None, pa.py_buffer(values)])


# Parquet files of a session: written whole, read a batch at a time.

ROW_GROUP = 20_000
"""Rows of a row group: some three minutes of ticks, of which an archiver holds one in memory."""

_BATCH_ROWS = 1 << 15
"""Rows that are read at a time: a few megabytes."""

_OPTIONS = {"compression": "zstd", "write_page_checksum": True}
_ENCODINGS = {
    pa.float64(): "BYTE_STREAM_SPLIT",
    pa.int64(): "DELTA_BINARY_PACKED",
    UTC: "DELTA_BINARY_PACKED",
}


def open_file(path: Path, mode: str) -> pa.OSFile:
    """Open a file for Arrow, which takes a name that is not UTF-8 as bytes alone.

    Args:
        path: The file.
        mode: `rb` or `wb`.

    Raises:
        OSError: It cannot be opened.
    """
    return pa.OSFile(os.fsencode(path), mode)


def write_parquet(
    path_of: Callable[[str], Path], batches: Iterable[tuple[str, pa.RecordBatch]]
) -> None:
    """Write a file for each table; they appear under their names when all are complete on the disk.

    Args:
        path_of: Returns the file of a table.
        batches: Rows, each batch with the name of its table; without a row no file is made.

    Raises:
        OSError: One cannot be written.
    """
    files: dict[Path, pq.ParquetWriter] = {}
    with ExitStack() as undone:
        with ExitStack() as opened:
            for table, group in _groups(batches):
                path = path_of(table)
                if path not in files:
                    undone.callback(_unfinished(path).unlink, missing_ok=True)
                    sink = opened.enter_context(open_file(_unfinished(path), "wb"))
                    writer = pq.ParquetWriter(sink, group.schema, **_options(group.schema))
                    files[path] = opened.enter_context(writer)
                files[path].write_table(group)
        for path in files:
            with _unfinished(path).open("rb") as written:
                os.fsync(written.fileno())
        for path in files:
            _unfinished(path).replace(path)


def _unfinished(path: Path) -> Path:
    return path.with_name(f"{path.name}.unfinished")


def read_parquet(path: Path, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a file a batch at a time; each page is held against its checksum.

    Args:
        path: The file.
        schema: The columns wanted.

    Raises:
        RecordingError: The file is damaged, or holds another table.
    """
    try:
        files.require_regular(path)
        with (
            open_file(path, "rb") as source,
            pq.ParquetFile(source, page_checksum_verification=True) as file,
        ):
            wanted = [name for name in schema.names if name in file.schema_arrow.names]
            # one thread: more of them take half as much processor time again, from the daemon
            for batch in file.iter_batches(_BATCH_ROWS, columns=wanted, use_threads=False):
                if batch.num_rows:
                    yield conform(batch, schema)
    except (pa.ArrowException, OSError, ValueError) as problem:
        raise RecordingError(path, str(problem)) from problem


def _options(schema: pa.Schema) -> dict[str, Any]:
    """Plain bits for numbers: a dictionary of floats would merge what only compares equal."""
    texts = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    numbers = {field.name: _ENCODINGS[field.type] for field in schema if field.type in _ENCODINGS}
    return {**_OPTIONS, "use_dictionary": texts, "column_encoding": numbers}


def _groups(
    batches: Iterable[tuple[str, pa.RecordBatch]],
) -> Iterator[tuple[str, pa.Table]]:
    """Yield row groups, each with its table; the last one of a table has what is left."""
    held = defaultdict[str, list[pa.RecordBatch]](list)
    for table, batch in batches:
        held[table].append(batch)
        if sum(one.num_rows for one in held[table]) >= ROW_GROUP:
            yield table, pa.Table.from_batches(held.pop(table))
    for table, group in held.items():
        yield table, pa.Table.from_batches(group)
