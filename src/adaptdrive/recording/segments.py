"""Segments of a session's tables, such as `ticks-0001.parquet`, and how their files are named.

A segment is an Arrow stream (`.arrows`) while it is written, because a stream that breaks off loses
only its last batch, and a Parquet file once it is closed. The stream is removed when the Parquet
file is complete on disk, and not before. Sessions of format 1 have one segment without a number.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet as pq

from adaptdrive.errors import RecordingError
from adaptdrive.files import require_regular
from adaptdrive.recording.session import TABLES
from adaptdrive.recording.streams import StreamReader, convert, open_file

_NAME = re.compile(rf"({'|'.join(TABLES)})(?:-(\d{{4,}}))?\.(arrows|parquet)")
_BATCH_ROWS = 1 << 15
"""Rows of a closed segment that are read at a time: a few megabytes."""


@dataclass(frozen=True, slots=True, order=True)
class Segment:
    """One segment of one table.

    Attributes:
        number: From 1; 0 in a session of format 1.
        table: Name of the table.
        path: Its file.
    """

    number: int
    table: str
    path: Path

    @property
    def closed(self) -> bool:
        """True once it is a Parquet file."""
        return self.path.suffix == ".parquet"

    def batches(
        self, columns: list[str] | None = None, *, strict: bool = False
    ) -> Iterator[pa.RecordBatch]:
        """Yield its rows a batch at a time, as they are on disk.

        Args:
            columns: The columns wanted, where the file has them; None for all.
            strict: Whether to hold each page against its checksum and to refuse a torn tail.

        Raises:
            RecordingError: The file is damaged.
        """
        if self.closed:
            yield from _parquet_batches(self.path, columns, strict=strict)
            return
        try:
            yield from _stream_batches(self.path, strict=strict)
        except RecordingError as problem:
            if not isinstance(problem.__cause__, FileNotFoundError):
                raise
            closed = self.path.with_suffix(".parquet")  # since this segment was listed
            if closed.exists():
                yield from _parquet_batches(closed, columns, strict=strict)

    def schema(self) -> pa.Schema:
        """Return its columns as they are on disk; none for a stream that broke off at its start."""
        if not self.closed:
            first = next(self.batches(), None)
            return pa.schema([]) if first is None else first.schema
        try:
            require_regular(self.path)
            with open_file(self.path, "rb") as source:
                return pq.read_schema(source)
        except (pa.ArrowException, OSError) as problem:
            raise RecordingError(self.path, str(problem)) from problem

    def close(self) -> None:
        """Turn the stream into a Parquet file, unless that is done already."""
        if not self.closed and self.path.exists():
            convert(self.path, self.path.with_suffix(".parquet"))


def stream_path(directory: Path, table: str, number: int) -> Path:
    """Return the path of a segment's stream."""
    return directory / f"{table}-{number:04}.arrows"


def segments(directory: Path, table: str | None = None) -> list[Segment]:
    """Return the segments of one table or of all, in their order.

    Args:
        directory: Directory of the session.
        table: Name of the table, None for all.
    """
    found: dict[tuple[int, str], Segment] = {}
    for path in sorted(directory.iterdir()):  # .arrows before .parquet, which prevails
        match = _NAME.fullmatch(path.name)
        if match and table in {None, match[1]}:
            number = int(match[2] or 0)
            found[number, match[1]] = Segment(number, match[1], path)
    return sorted(found.values())


def newest_number(found: Iterable[Segment]) -> int:
    """Return the number of the last of some segments, 0 for none."""
    return max((segment.number for segment in found), default=0)


def _stream_batches(path: Path, *, strict: bool) -> Iterator[pa.RecordBatch]:
    reader = StreamReader(path)
    yield from reader.batches()
    if strict and reader.torn:
        raise RecordingError(path, "it breaks off within a batch, which is left out")


def _parquet_batches(
    path: Path, columns: list[str] | None, *, strict: bool
) -> Iterator[pa.RecordBatch]:
    try:
        require_regular(path)
        with (
            open_file(path, "rb") as source,
            pq.ParquetFile(source, page_checksum_verification=strict) as file,
        ):
            wanted = columns and [name for name in columns if name in file.schema_arrow.names]
            yield from file.iter_batches(_BATCH_ROWS, columns=wanted)
    except (pa.ArrowException, OSError) as problem:
        raise RecordingError(path, str(problem)) from problem
