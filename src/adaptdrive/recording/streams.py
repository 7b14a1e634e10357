"""Arrow streams that may break off, and the Parquet files made of them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import ipc
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.files import require_regular

_ROW_GROUP = 25_000
"""Rows of a Parquet row group: four minutes of ticks, of which a recorder holds one in memory."""

_LARGEST_PIECES = 100
"""Pieces that a row group may have: a batch of a few rows has more memory for the descriptions of
its columns than for their values."""

TORN = ".torn"
"""Suffix of a stream that broke off, kept beside the Parquet file of its whole batches."""

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


class StreamWriter:
    """One Arrow stream; each batch is in the operating system's hands when `write` returns.

    Attributes:
        path: Its file.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.path = path
        self._sink = pa.OSFile(str(path), "wb")
        options = ipc.IpcWriteOptions(compression="zstd")
        self._stream = ipc.new_stream(self._sink, schema, options=options)

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch."""
        self._stream.write_batch(batch)
        self._sink.flush()

    def close(self) -> None:
        """Mark the end of the stream."""
        self._stream.close()
        self._sink.close()

    def abandon(self) -> None:
        """Close a stream that cannot be written any more; what it holds stays readable."""
        with contextlib.suppress(OSError, pa.ArrowException):
            self._sink.close()


class StreamReader:
    """The batches of a stream, up to its end or to where it broke off."""

    def __init__(self, path: Path) -> None:
        self.torn = False
        self._path = path

    def batches(self) -> Iterator[pa.RecordBatch]:
        """All whole batches; afterwards `torn` is true if a piece of one followed them.

        Raises:
            RecordingError: The stream cannot be opened or read.
        """
        try:
            require_regular(self._path)
            with open_file(self._path, "rb") as source:
                yield from self._whole_batches(source)
        except (OSError, pa.ArrowMemoryError) as problem:
            raise RecordingError(self._path, str(problem)) from problem

    def _whole_batches(self, source: pa.NativeFile) -> Iterator[pa.RecordBatch]:
        stream = self._opened(source)
        while stream is not None:
            try:
                batch = stream.read_next_batch()
                batch.validate(full=True)
            except StopIteration:
                return
            except (pa.ArrowException, OSError) as problem:
                _require_readable(problem)
                self.torn = True
                return
            yield batch

    def _opened(self, source: pa.NativeFile) -> ipc.RecordBatchStreamReader | None:
        """The opened stream, None when it breaks off before its first batch, or its names do."""
        if source.size() == 0:
            return None
        try:
            stream = ipc.open_stream(source)
            _ = stream.schema.names  # read now: those of a damaged one may be no text
        except (pa.ArrowException, OSError, UnicodeDecodeError) as problem:
            _require_readable(problem)
            self.torn = True
            return None
        return stream


def _require_readable(problem: Exception) -> None:
    """Raise an error of the disk or for want of memory: the file itself may be whole."""
    of_disk = isinstance(problem, OSError) and problem.errno is not None
    if of_disk or isinstance(problem, pa.ArrowMemoryError):
        raise problem


def convert(stream: Path, target: Path) -> None:
    """Turn a stream into a Parquet file, and remove the stream once that is safely on disk.

    A stream without a whole batch leaves no Parquet file. One that breaks off within a batch is
    kept under another name (`TORN`).

    Args:
        stream: The Arrow stream.
        target: The Parquet file; it appears under this name when it is complete.

    Raises:
        RecordingError: The stream cannot be read; it is left as it is.
        OSError: The Parquet file cannot be written.
    """
    unfinished = target.with_name(f"{target.name}.unfinished")
    reader = StreamReader(stream)
    groups = _groups(reader.batches())
    first = next(groups, None)
    if first is not None:
        schema = first.schema
        with pq.ParquetWriter(unfinished, schema, **_OPTIONS, **_encodings(schema)) as file:
            for group in chain([first], groups):
                file.write_table(group)
        with unfinished.open("rb") as written:
            os.fsync(written.fileno())
        unfinished.replace(target)
    if reader.torn:
        stream.rename(stream.with_suffix(TORN))
    else:
        stream.unlink()
    pa.default_memory_pool().release_unused()  # else a recorder keeps it until its next segment


def _encodings(schema: pa.Schema) -> dict[str, Any]:
    """Plain bits for numbers: a dictionary of floats would merge what only compares equal."""
    texts = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    numbers = {field.name: _ENCODINGS[field.type] for field in schema if field.type in _ENCODINGS}
    return {"use_dictionary": texts, "column_encoding": numbers}


def _groups(batches: Iterator[pa.RecordBatch]) -> Iterator[pa.Table]:
    """Yield row groups; the last has what is left."""
    group: list[pa.Table] = []
    rows = 0
    for batch in batches:
        group.append(pa.Table.from_batches([batch]))
        rows += batch.num_rows
        if len(group) == _LARGEST_PIECES:
            group = [pa.concat_tables(group).combine_chunks()]
        if rows >= _ROW_GROUP:
            yield pa.concat_tables(group)
            group, rows = [], 0
    if group:
        yield pa.concat_tables(group)
