"""Columns on disk: the Arrow schemas, and record batches made from what came through the pipe."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pyarrow as pa

from adaptdrive.recording.batches import TICK_COLUMNS, SlowRow

TEXT = pa.dictionary(pa.int32(), pa.string())

_TYPES = {"d": pa.float64(), "q": pa.int64(), "b": pa.bool_(), "s": TEXT}

TICKS_SCHEMA = pa.schema([(column.name, _TYPES[column.code]) for column in TICK_COLUMNS])

_NUMBERS = pa.list_(pa.float64())
_ESTIMATE = pa.struct([("name", pa.string()), ("value", pa.float64()), ("std", pa.float64())])

SLOW_SCHEMA = pa.schema(
    [
        ("k", pa.int64()),
        ("tick", pa.int64()),
        ("period_s", pa.float64()),
        ("reference", pa.float64()),
        ("output", pa.float64()),
        ("output_filtered", _NUMBERS),
        ("input_filtered", _NUMBERS),
        ("applied_V", pa.float64()),
        ("followed", pa.bool_()),
        ("held_ticks", pa.int64()),
        ("boost_reference_V", pa.float64()),
        ("controller", TEXT),
        ("accepted", pa.bool_()),
        ("reason", TEXT),
        ("estimates", pa.list_(_ESTIMATE)),
        ("gains", _NUMBERS),
        ("innovation", pa.float64()),
        ("excitation", pa.float64()),
        ("handover_step_V", pa.float64()),
    ]
)


def ticks_batch(columns: dict[str, bytes | list[str]], rows: int) -> pa.RecordBatch:
    """Fast ticks as a record batch.

    Args:
        columns: Machine arrays and strings by column name.
        rows: Number of ticks.
    """
    arrays = [_array(field.type, columns[field.name], rows) for field in TICKS_SCHEMA]
    return pa.RecordBatch.from_arrays(arrays, schema=TICKS_SCHEMA)


def slow_batch(rows: Sequence[SlowRow]) -> pa.RecordBatch:
    """Slow steps as a record batch."""
    return pa.RecordBatch.from_pylist(
        [msgspec.to_builtins(row) for row in rows], schema=SLOW_SCHEMA
    )


def _array(kind: pa.DataType, values: bytes | list[str], rows: int) -> pa.Array:
    if isinstance(values, list):
        return pa.array(values, pa.string()).dictionary_encode()
    stored = pa.int8() if kind == pa.bool_() else kind
    return pa.Array.from_buffers(stored, rows, [None, pa.py_buffer(values)]).cast(kind)
