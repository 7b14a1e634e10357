"""Tables on disk: Arrow schemas that explain themselves, and record batches that fit them.

Each field has `unit`, `description` and `source` as metadata. A table of an older format is
completed with NaN and nulls where it lacks columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from adaptdrive.control.columns import Column
from adaptdrive.recording.batches import SensorColumn
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
_CHOICES = {one.name: one.choices for one in (*TICK_COLUMNS, *SLOW_COLUMNS) if one.choices}
_IN_EVERY_VERSION = "controller"
"""One of them that no version's slow steps lack: a table without it is another one."""


def _field(name: str, kind: pa.DataType, unit: str, meaning: str, source: str) -> pa.Field:
    about = {"unit": unit, "description": meaning, "source": source}
    return pa.field(name, kind, metadata=about)


_UTC_FIELD = _field("utc", UTC, "", "wall-clock time of the row, UTC", f"{MONOTONIC} + offset")
_MONOTONIC_FIELD = _field(MONOTONIC, pa.float64(), "s", "monotonic time of the row", "daemon")


def ticks_schema(output_unit: str = "") -> pa.Schema:
    """Return the schema of the fast ticks.

    Args:
        output_unit: Unit of the regulated quantity.
    """
    return _schema(TICK_COLUMNS, output_unit)


def slow_schema(output_unit: str = "") -> pa.Schema:
    """Return the schema of the slow steps.

    Args:
        output_unit: Unit of the regulated quantity.
    """
    return _schema(SLOW_COLUMNS, output_unit)


def sensors_schema(sensors: Sequence[SensorColumn]) -> pa.Schema:
    """Return the schema of the sensor buses."""
    fields = [_field(one.name, pa.float64(), one.unit, one.meaning, one.source) for one in sensors]
    return pa.schema([_UTC_FIELD, _MONOTONIC_FIELD, *fields])


def _schema(columns: Sequence[Column], output_unit: str) -> pa.Schema:
    special = {"y": output_unit, "u": INPUT_UNIT}
    fields = [
        _field(
            column.name,
            _TYPES[column.kind],
            special.get(column.unit, column.unit),
            column.meaning,
            column.source,
        )
        for column in columns
    ]
    return pa.schema([_UTC_FIELD, *fields])


def ticks_batch(
    columns: Mapping[str, bytes | list[str]], rows: int, schema: pa.Schema, utc_offset_s: float
) -> pa.RecordBatch:
    """Return fast ticks as a record batch.

    Args:
        columns: Machine arrays and strings by column name; those of another version may be more or
            fewer.
        rows: Number of ticks.
        schema: Schema of the ticks.
        utc_offset_s: UTC minus monotonic time.
    """
    fields = [field for field in schema if field.name in columns]
    arrays = {field.name: _array(field.type, columns[field.name], rows) for field in fields}
    arrays[_UTC_FIELD.name] = _utc(arrays[MONOTONIC], utc_offset_s)
    return conform(pa.RecordBatch.from_pydict(arrays), schema)


def rows_batch(
    rows: Sequence[dict[str, Any]], schema: pa.Schema, utc_offset_s: float
) -> pa.RecordBatch:
    """Return rows of slow steps or sensors as a record batch; a value that a row lacks is null.

    Args:
        rows: Values by name of their column.
        schema: Schema of the table.
        utc_offset_s: UTC minus monotonic time.
    """
    for row in rows:
        time_s = row[MONOTONIC]
        known = math.isfinite(time_s)
        row["utc"] = round((time_s + utc_offset_s) * 1e6) if known else None
    return pa.RecordBatch.from_pylist(rows, schema=schema)


def conform(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return the columns of a schema from a batch of this or an older format.

    Args:
        batch: Rows as they are on disk.
        schema: The columns wanted; those that the batch lacks are NaN or null.
    """
    arrays = [_column(batch, field) for field in schema]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def foreign_value(batch: pa.RecordBatch) -> str | None:
    """Return a value that its column cannot have, in words; None where there is none.

    Args:
        batch: Rows that conform to a schema.
    """
    for name, choices in _CHOICES.items():
        if name in batch.schema.names:
            for value in pc.unique(batch.column(name)).to_pylist():
                missing = value is None and name != _IN_EVERY_VERSION
                if value not in choices and not missing:
                    return f"{name} is {value!r}, which is none of {', '.join(choices)}"
    return None


def _column(batch: pa.RecordBatch, field: pa.Field) -> pa.Array:
    if field.name not in batch.schema.names:
        missing = pa.scalar(math.nan if field.type == pa.float64() else None, field.type)
        return pa.repeat(missing, batch.num_rows)
    found = batch.column(field.name)
    return found if found.type == field.type else found.cast(field.type)


def _utc(monotonic_s: pa.Array, offset_s: float) -> pa.Array:
    microseconds = pc.round(pc.multiply(pc.add(monotonic_s, offset_s), 1e6))
    known = pc.if_else(pc.is_finite(microseconds), microseconds, None)
    return known.cast(pa.int64()).cast(UTC)


def _array(kind: pa.DataType, values: bytes | list[str], rows: int) -> pa.Array:
    if isinstance(values, list):
        return pa.array(values, pa.string()).dictionary_encode()
    stored = pa.int8() if kind == pa.bool_() else kind
    return pa.Array.from_buffers(stored, rows, [None, pa.py_buffer(values)]).cast(kind)
