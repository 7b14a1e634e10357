"""Sessions in the formats of other programs, and as tables without lists."""

import functools
import itertools
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv
from pyarrow import parquet as pq

from adaptdrive.analysis.curves import row_times
from adaptdrive.recording import reader
from adaptdrive.recording.session import TABLES
from adaptdrive.recording.tables import open_file

Batches = Iterator[pa.RecordBatch]

# Tables of a session without lists, as other programs read them, and those of polars.


def flat_tables(session: reader.Session) -> Iterator[tuple[str, pa.Schema, Batches]]:
    """Yield each table that has rows, without lists, and its rows, which are read once.

    A list is spread over columns, such as `gains_0`: one for each element and estimate.
    """
    for table in TABLES:
        batches = _flat_batches(session, table)
        if (first := next(batches, None)) is not None:
            yield table, first.schema, itertools.chain((first,), batches)


def _flat_batches(session: reader.Session, table: str) -> Batches:
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


def session_frames(path: Path) -> dict[str, Any]:
    """Return the tables of a session by name, of polars, with `info` and `units`."""
    from polars import from_arrow  # noqa: PLC0415 - exports do without

    session = reader.read_session(path)
    if session.damage:
        warnings.warn(session.damage, stacklevel=3)
    tables = {name: pa.table({}) for name in TABLES} | _whole(session)
    units = {
        field.name: unit
        for table in tables.values()
        for field in table.schema
        if (unit := _about(field, "unit"))
    }
    tables["events"] = _rows(session.events)
    tables["commands"] = _rows(session.commands)
    made = {name: from_arrow(table) for name, table in tables.items()}
    return {"info": session.info, "units": units, **made}


def _whole(session: reader.Session) -> dict[str, pa.Table]:
    """Return the tables that have rows, all of them in memory."""
    return {
        table: pa.Table.from_batches(list(batches), schema)
        for table, schema, batches in flat_tables(session)
    }


def _rows(rows: tuple[Any, ...]) -> pa.Table:
    return pa.Table.from_pylist([msgspec.structs.asdict(row) for row in rows])


# Sessions in the formats of other programs, with units where a format has a place for them.

_NANOSECONDS = 1_000_000_000
_LONGEST_FIELD = 63
"""Letters of the name of a field that MATLAB accepts."""


def export(path: Path, to: str, into: Path) -> list[Path]:
    """Write a session in the format of another program.

    Args:
        path: Directory of the session.
        to: `csv`, `parquet`, `mat`, `mdf4` or `mcap`.
        into: Folder for the files; made when absent.

    Returns:
        The files.

    Raises:
        AdaptdriveError: The session cannot be read.
        ModuleNotFoundError: The library for the format is not installed.
        OSError: The files cannot be written; those there are as before.
    """
    session = reader.read_session(path)
    into.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryDirectory(dir=into, prefix=".unfinished-") as beside:
            return [one.replace(into / one.name) for one in _WRITERS[to](session, Path(beside))]
    except OSError as problem:
        problem.filename = str(into)
        raise


def _write_tables(
    session: reader.Session, into: Path, suffix: str, writer: Callable[..., Any]
) -> list[Path]:
    """Write a file for each table."""
    paths = []
    for table, schema, batches in flat_tables(session):
        path = into / f"{session.path.name}_{table}.{suffix}"
        with open_file(path, "wb") as sink, writer(sink, schema) as file:
            for batch in batches:
                file.write_batch(batch.cast(schema))
        paths.append(path)
    return paths


def _write_mat(session: reader.Session, into: Path) -> list[Path]:
    from scipy.io import savemat  # noqa: PLC0415 - an extra

    contents: dict[str, Any] = {}
    for table, whole in _whole(session).items():
        fields = _field_names(whole.column_names)
        contents[table] = {field: _matlab(whole[name]) for name, field in fields.items()}
        contents[f"{table}_units"] = {fields[field.name]: _unit(field) for field in whole.schema}
        if renamed := {field: name for name, field in fields.items() if field != name}:
            contents[f"{table}_names"] = renamed
    path = into / f"{session.path.name}.mat"
    savemat(path, contents, do_compression=True, long_field_names=True, oned_as="column")
    return [path]


def _field_names(columns: list[str]) -> dict[str, str]:
    """Return a name that MATLAB accepts for a field of a struct, by the name of each column."""
    fields: dict[str, str] = {}
    for name in columns:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        whole = plain if plain[0].isalpha() else f"x{plain}"
        field = whole[:_LONGEST_FIELD]
        for number in itertools.count(2):
            if field not in fields.values():
                break
            field = f"{whole[: _LONGEST_FIELD - 4]}_{number}"
        fields[name] = field
    return fields


def _write_mdf4(session: reader.Session, into: Path) -> list[Path]:
    from asammdf import MDF, Signal  # noqa: PLC0415 - an extra

    path = into / f"{session.path.name}.mf4"
    tables = _whole(session)
    times_s = {
        name: np.concatenate([row_times(session, batch) for batch in whole.to_batches()])
        for name, whole in tables.items()
    }
    started = session.info.started
    begins = [(times_s[name][0], whole["utc"][0].as_py()) for name, whole in tables.items()]
    begin_s, begun = min(begins, key=lambda one: one[0], default=(0.0, started))
    with MDF(version="4.10") as file:
        file.start_time = begun or started
        for table, whole in tables.items():
            signals = [
                Signal(
                    samples=_samples(whole[field.name]),
                    timestamps=times_s[table] - begin_s,
                    name=field.name,
                    unit=_unit(field),
                    comment=_about(field, "description"),
                    encoding="utf-8",
                )
                for field in whole.schema
                if field.name != "monotonic_s"
            ]
            file.append(signals, comment=table)
        return [Path(file.save(path, overwrite=True))]


def _write_mcap(session: reader.Session, into: Path) -> list[Path]:
    from mcap.writer import Writer  # noqa: PLC0415 - an extra

    path = into / f"{session.path.name}.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="adaptdrive")
        for table, schema, batches in flat_tables(session):
            text = msgspec.json.encode(_json_schema(table, schema))
            kind = writer.register_schema(f"adaptdrive.{table}", "jsonschema", text)
            channel = writer.register_channel(f"/{session.info.drive}/{table}", "json", kind)
            for time_ns, message in _messages(session, batches):
                writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=message)
        writer.finish()  # type: ignore[no-untyped-call]
    return [path]


def _messages(session: reader.Session, batches: Batches) -> Iterator[tuple[int, bytes]]:
    start_ns = round(session.info.started.timestamp() * _NANOSECONDS)
    for batch in batches:
        for row in batch.to_pylist():
            utc = row.pop("utc")
            time_ns = round(utc.timestamp() * 1e6) * 1000 if utc else start_ns
            yield time_ns, msgspec.json.encode(row)  # which writes null for NaN


def _json_schema(table: str, schema: pa.Schema) -> dict[str, Any]:
    properties = {
        field.name: {"description": f"{_about(field, 'description')} [{_unit(field)}]"}
        for field in schema
        if field.name != "utc"
    }
    return {"title": table, "type": "object", "properties": properties}


def _samples(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return the values of a column; null, as in a column of a later version, is NaN or empty."""
    if pa.types.is_timestamp(column.type):
        column = pc.divide(column.cast(pa.int64()).cast(pa.float64()), 1e6)
    if pa.types.is_string(column.type):
        return np.asarray([text.encode() for text in _texts(column)])
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.uint8())
    return np.asarray(column.to_numpy())


def _matlab(column: pa.ChunkedArray) -> NDArray[Any]:
    if pa.types.is_string(column.type):
        return np.asarray(_texts(column), dtype=object)
    return _samples(column)


def _texts(column: pa.ChunkedArray) -> list[str]:
    return pc.fill_null(column, "").to_pylist()  # type: ignore[no-any-return]


def _unit(field: pa.Field) -> str:
    return "s" if field.name == "utc" else _about(field, "unit")


def _about(field: pa.Field, key: str) -> str:
    return (field.metadata or {}).get(key.encode(), b"").decode()  # type: ignore[no-any-return]


_WRITERS: dict[str, Callable[[reader.Session, Path], list[Path]]] = {
    "csv": functools.partial(_write_tables, suffix="csv", writer=csv.CSVWriter),
    "parquet": functools.partial(
        _write_tables,
        suffix="parquet",
        writer=functools.partial(pq.ParquetWriter, compression="zstd"),
    ),
    "mat": _write_mat,
    "mdf4": _write_mdf4,
    "mcap": _write_mcap,
}
