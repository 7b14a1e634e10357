"""A session as tables of polars or pandas."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.analysis.flat import flat_batches, flat_schema
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.session import TABLES


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
