"""Tables on disk: Arrow schemas that explain themselves, and record batches that fit them.

Each field has `unit`, `description` and `source` as metadata.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from itertools import chain
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.control.columns import Column
from adaptdrive.quantity import BOOST
from adaptdrive.recording.records import CommandRow, EventRow, Ticks
from adaptdrive.recording.session import SensorColumn, SessionInfo, TableName
from adaptdrive.runtime.reports import MONOTONIC, SLOW_COLUMNS, TICK_COLUMNS

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
_NOTE_TYPES = _TYPES | {str: pa.string(), datetime: UTC}
_CHOICES = {one.name: one.choices for one in (*TICK_COLUMNS, *SLOW_COLUMNS) if one.choices}


def _field(column: Column | SensorColumn, kind: pa.DataType, unit: str) -> pa.Field:
    about = {"unit": unit, "description": column.meaning, "source": column.source}
    return pa.field(column.name, kind, metadata=about)


_UTC_FIELD = _field(
    SensorColumn("utc", "", "wall-clock time of the row, UTC", f"{MONOTONIC} + offset"), UTC, ""
)
_MONOTONIC = SensorColumn(MONOTONIC, "s", "monotonic time of the row", "daemon")
_MONOTONIC_FIELD = _field(_MONOTONIC, pa.float64(), _MONOTONIC.unit)


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
        given = info.manipulated if info else BOOST
        units = {"y": info.output_unit if info else "", "u": INPUT_UNIT, "v": given.unit}
        columns = TICK_COLUMNS if table == TableName.TICKS else SLOW_COLUMNS
        fields = [_field(one, _TYPES[one.kind], units.get(one.unit, one.unit)) for one in columns]
    return pa.schema([_UTC_FIELD, *fields])


def ticks_batch(timed: Sequence[tuple[Ticks, float]], schema: pa.Schema) -> pa.RecordBatch:
    """Return fast ticks as a record batch.

    Args:
        timed: Ticks, each with UTC minus monotonic time in seconds.
        schema: Schema of the ticks.
    """
    rows = sum(ticks.rows for ticks, _ in timed)
    arrays = {
        field.name: _array(field.type, [ticks.columns[field.name] for ticks, _ in timed], rows)
        for field in (_MONOTONIC_FIELD, *schema)
        if field.name != _UTC_FIELD.name
    }
    offsets = (offset_s for ticks, offset_s in timed for _ in range(ticks.rows))
    arrays[_UTC_FIELD.name] = pa.array(map(_utc, arrays[MONOTONIC].to_pylist(), offsets), UTC)
    return pa.RecordBatch.from_arrays([arrays[name] for name in schema.names], schema=schema)


def rows_batch(
    timed: Sequence[tuple[list[dict[str, Any]], float]], schema: pa.Schema
) -> pa.RecordBatch:
    """Return rows of any other table as a record batch; a value that a row lacks is null.

    Args:
        timed: Rows by name of their columns, each with UTC minus monotonic time in seconds.
        schema: Schema of the table.
    """
    rows = (
        row | {_UTC_FIELD.name: _utc(row[MONOTONIC], offset_s)}
        for rows, offset_s in timed
        for row in rows
    )
    return pa.RecordBatch.from_pylist(list(rows), schema=schema)


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
