"""Columns on disk: the Arrow schemas, and record batches made from what came through the pipe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from adaptdrive.control.columns import Column
from adaptdrive.runtime.reports import SLOW_COLUMNS, TICK_COLUMNS

_ESTIMATE = pa.struct([("name", pa.string()), ("value", pa.float64()), ("std", pa.float64())])

_TYPES = {
    float: pa.float64(),
    int: pa.int64(),
    bool: pa.bool_(),
    str: pa.dictionary(pa.int32(), pa.string()),
    tuple: pa.list_(pa.float64()),
    dict: pa.list_(_ESTIMATE),
}


def _schema(columns: Sequence[Column]) -> pa.Schema:
    return pa.schema([(column.name, _TYPES[column.kind]) for column in columns])


TICKS_SCHEMA = _schema(TICK_COLUMNS)
SLOW_SCHEMA = _schema(SLOW_COLUMNS)


def ticks_batch(columns: dict[str, bytes | list[str]], rows: int) -> pa.RecordBatch:
    """Fast ticks as a record batch.

    Args:
        columns: Machine arrays and strings by column name.
        rows: Number of ticks.
    """
    arrays = [_array(field.type, columns[field.name], rows) for field in TICKS_SCHEMA]
    return pa.RecordBatch.from_arrays(arrays, schema=TICKS_SCHEMA)


def slow_batch(rows: list[dict[str, Any]]) -> pa.RecordBatch:
    """Slow steps as a record batch."""
    return pa.RecordBatch.from_pylist(rows, schema=SLOW_SCHEMA)


def _array(kind: pa.DataType, values: bytes | list[str], rows: int) -> pa.Array:
    if isinstance(values, list):
        return pa.array(values, pa.string()).dictionary_encode()
    stored = pa.int8() if kind == pa.bool_() else kind
    return pa.Array.from_buffers(stored, rows, [None, pa.py_buffer(values)]).cast(kind)
