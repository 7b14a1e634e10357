"""Tables of a session without lists, as other programs read them, and those of polars or pandas."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.session import TABLES


def flat_schema(session: Session, table: str) -> pa.Schema:
    """Return the columns of a table without lists: one for each element and estimate."""
    first = next(flat_batches(session, table), None)
    return pa.schema([]) if first is None else first.schema


def flat_batches(session: Session, table: str) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a table with each list spread over columns, such as `gains_0`."""
    widths: dict[str, list[str]] = {}
    for batch in session.batches(table):
        columns: dict[str, tuple[pa.Field, pa.Array]] = {}
        for field, column in zip(batch.schema, batch.columns, strict=True):
            for name, values in _spread(field, column, widths):
                columns[name] = pa.field(name, values.type, metadata=field.metadata), values
        fields = [field for field, _ in columns.values()]
        arrays = [values for _, values in columns.values()]
        yield pa.RecordBatch.from_arrays(arrays, schema=pa.schema(fields))


def _spread(
    field: pa.Field, column: pa.Array, widths: dict[str, list[str]]
) -> Iterator[tuple[str, pa.Array]]:
    """Yield the columns of one column; which these are, the first batch decides."""
    if pa.types.is_dictionary(field.type):
        yield field.name, column.cast(pa.string())
    elif not pa.types.is_list(field.type):
        yield field.name, column
    elif pa.types.is_struct(field.type.value_type):
        names = widths.setdefault(field.name, _names(column))
        for at, name in enumerate(names):
            item = _element(column, at)
            yield name, pc.struct_field(item, "value")
            yield f"{name}_std", pc.struct_field(item, "std")
    else:
        lengths = pc.max(pc.list_value_length(column)).as_py() or 0
        known = widths.setdefault(field.name, [str(at) for at in range(lengths)])
        for at, _ in enumerate(known):
            yield f"{field.name}_{at}", _element(column, at)


def _names(column: pa.Array) -> list[str]:
    return next(
        (["estimate_" + one["name"] for one in row] for row in column.to_pylist() if row), []
    )


def _element(column: pa.Array, at: int) -> pa.Array:
    """Return one element of each list, null where a list is shorter."""
    if pc.all(pc.greater(pc.list_value_length(column), at)).as_py():
        return pc.list_element(column, at)
    items = [row[at] if row and len(row) > at else None for row in column.to_pylist()]
    return pa.array(items, column.type.value_type)


def session_frames(path: Path, frames: str) -> dict[str, Any]:
    """Return the tables of a session by name, with `info` and `units`.

    Args:
        path: Directory of the session.
        frames: `polars` or `pandas`.
    """
    session = read_session(path)
    if session.damage:
        warnings.warn(session.damage, stacklevel=3)
    tables = {name: _table(session, name) for name in TABLES}
    units = {
        field.name: unit
        for table in tables.values()
        for field in table.schema
        if (unit := (field.metadata or {}).get(b"unit", b"").decode())
    }
    tables["events"] = _rows(session.events)
    tables["commands"] = _rows(session.commands)
    made = {name: _frame(table, frames) for name, table in tables.items()}
    return {"info": session.info, "units": units, **made}


def _table(session: Session, name: str) -> pa.Table:
    return pa.Table.from_batches(list(flat_batches(session, name)), flat_schema(session, name))


def _rows(rows: tuple[Any, ...]) -> pa.Table:
    return pa.Table.from_pylist([msgspec.structs.asdict(row) for row in rows])


def _frame(table: pa.Table, frames: str) -> Any:  # noqa: ANN401 - of either library
    if frames == "pandas":
        return table.to_pandas()
    import polars  # noqa: ICN001, PLC0415 - one of two

    return polars.from_arrow(table)
