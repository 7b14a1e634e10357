"""Arrow streams that may break off, and the Parquet files made of them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa
from pyarrow import ipc
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError

_ROW_GROUP = 100_000
"""Rows of a Parquet row group: a quarter of an hour of ticks."""


class StreamWriter:
    """One Arrow stream; each batch is in the operating system's hands when `write` returns."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
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


class StreamReader:
    """The batches of a stream, up to its end or to where it broke off."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.torn = False
        self._path = path
        self._schema = schema

    def batches(self) -> Iterator[pa.RecordBatch]:
        """All whole batches; afterwards `torn` tells whether a piece of one followed them.

        Raises:
            RecordingError: The stream cannot be opened or holds other columns.
        """
        try:
            with pa.OSFile(str(self._path), "rb") as source:
                yield from self._whole_batches(source)
        except OSError as problem:
            raise RecordingError(self._path, str(problem)) from problem

    def _whole_batches(self, source: pa.NativeFile) -> Iterator[pa.RecordBatch]:
        stream = self._opened(source)
        while stream is not None:
            try:
                batch = stream.read_next_batch()
                batch.validate(full=True)
            except StopIteration:
                return
            except (pa.ArrowException, OSError):
                self.torn = True
                return
            yield batch

    def _opened(self, source: pa.NativeFile) -> ipc.RecordBatchStreamReader | None:
        """The opened stream, None when it breaks off before its first batch."""
        if source.size() == 0:
            return None
        try:
            stream = ipc.open_stream(source)
        except (pa.ArrowException, OSError):
            self.torn = True
            return None
        if stream.schema != self._schema:
            raise RecordingError(self._path, "its columns are not those known here")
        return stream


def convert(stream: Path, target: Path, schema: pa.Schema) -> None:
    """Turn a stream into a Parquet file, and remove the stream once that is safely on disk.

    Args:
        stream: The Arrow stream.
        target: The Parquet file; it appears under this name when it is complete.
        schema: Columns of both.
    """
    unfinished = target.with_name(f"{target.name}.unfinished")
    with pq.ParquetWriter(unfinished, schema, compression="zstd", **_encodings(schema)) as file:
        for group in _groups(StreamReader(stream, schema).batches()):
            file.write_table(pa.Table.from_batches(group, schema))
    with unfinished.open("rb") as written:
        os.fsync(written.fileno())
    unfinished.replace(target)
    stream.unlink()


def _encodings(schema: pa.Schema) -> dict[str, Sequence[str]]:
    """Plain bits for numbers: a dictionary of floats would merge what only compares equal."""
    texts = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    floats = [field.name for field in schema if field.type == pa.float64()]
    return {"use_dictionary": texts, "use_byte_stream_split": floats}


def _groups(batches: Iterator[pa.RecordBatch]) -> Iterator[list[pa.RecordBatch]]:
    group: list[pa.RecordBatch] = []
    rows = 0
    for batch in batches:
        group.append(batch)
        rows += batch.num_rows
        if rows >= _ROW_GROUP:
            yield group
            group, rows = [], 0
    if group:
        yield group
