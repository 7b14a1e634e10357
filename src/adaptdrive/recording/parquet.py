"""Parquet files of a session: written whole, read a batch at a time."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.files import require_regular
from adaptdrive.recording.tables import conform

ROW_GROUP = 20_000
"""Rows of a row group: some three minutes of ticks, of which an archiver holds one in memory."""

_BATCH_ROWS = 1 << 15
"""Rows that are read at a time: a few megabytes."""

_OPTIONS = {"compression": "zstd", "write_page_checksum": True}
_ENCODINGS = {
    pa.float64(): "BYTE_STREAM_SPLIT",
    pa.int64(): "DELTA_BINARY_PACKED",
    pa.timestamp("us", "UTC"): "DELTA_BINARY_PACKED",
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


def write_parquet(path: Path, batches: Iterable[pa.RecordBatch]) -> None:
    """Write a file; it appears under its name when it is complete on the disk.

    Args:
        path: The file.
        batches: Its rows; without a row no file is made.

    Raises:
        OSError: It cannot be written.
    """
    groups = _groups(batches)
    first = next(groups, None)
    if first is None:
        return
    unfinished = path.with_name(f"{path.name}.unfinished")
    schema = first.schema
    try:
        with (
            open_file(unfinished, "wb") as sink,
            pq.ParquetWriter(sink, schema, **_OPTIONS, **_encodings(schema)) as file,
        ):
            for group in chain([first], groups):
                file.write_table(group)
        with unfinished.open("rb") as written:
            os.fsync(written.fileno())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def read_parquet(path: Path, schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    """Yield the rows of a file a batch at a time; each page is held against its checksum.

    Args:
        path: The file.
        schema: The columns wanted.

    Raises:
        RecordingError: The file is damaged, or holds another table.
    """
    try:
        require_regular(path)
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


def _encodings(schema: pa.Schema) -> dict[str, Any]:
    """Plain bits for numbers: a dictionary of floats would merge what only compares equal."""
    texts = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    numbers = {field.name: _ENCODINGS[field.type] for field in schema if field.type in _ENCODINGS}
    return {"use_dictionary": texts, "column_encoding": numbers}


def _groups(batches: Iterable[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Yield row groups; the last has what is left."""
    group: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        group.append(batch)
        rows += batch.num_rows
        if rows >= ROW_GROUP:
            yield pa.Table.from_batches(group)
            group, rows = [], 0
    if rows:
        yield pa.Table.from_batches(group)
