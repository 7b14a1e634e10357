"""Segments of a session's tables: Parquet files, and after them what is in the log only."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import msgspec
import pyarrow as pa

from adaptdrive.errors import RecordingError
from adaptdrive.recording.log_files import LogFile, first_begin, unarchived
from adaptdrive.recording.log_tables import logged_batches
from adaptdrive.recording.parquet import parquet_schema, read_parquet, write_parquet
from adaptdrive.recording.session import NOTES, TABLES, TICKS, SessionInfo
from adaptdrive.recording.tables import conform, table_schema
from adaptdrive.runtime.statistics import BINS, bin_of

EVERY_TICK = "lateness_us"
"""The histogram that counts every tick: a stand-in tick has no turnaround."""

_TIMES = (EVERY_TICK, "turnaround_us", "tick_us")
Batches = Iterator[pa.RecordBatch]
_ALL = (*TABLES, *NOTES)
_NAME = re.compile(rf"({'|'.join(_ALL)})-(\d{{4,}})\.parquet")


@dataclass(frozen=True, slots=True, order=True)
class Segment:
    """One segment of one table.

    Attributes:
        number: From 1.
        table: Name of the table.
        path: Its Parquet file, which is not made yet where it is in the log.
        logged: Files of the log that hold it; none once there is the Parquet file.
    """

    number: int
    table: str
    path: Path
    logged: tuple[LogFile, ...] = ()

    @property
    def closed(self) -> bool:
        """True once it is a Parquet file, perhaps since it was listed."""
        return not self.logged or self.path.exists()

    def batches(self, columns: list[str] | None = None, losses: list[str] | None = None) -> Batches:
        """Yield its rows a batch at a time, as they are on disk.

        Args:
            columns: The columns wanted, where the segment has them; None for all.
            losses: Takes what of the log cannot be read, in words.

        Raises:
            RecordingError: The file is damaged.
        """
        if self.closed:
            yield from read_parquet(self.path, columns)
            return
        schema = self._logged_schema()
        wanted = [name for name in schema.names if columns is None or name in columns]
        for batch in logged_batches(self.logged, self.table, schema, losses):
            yield batch.select(wanted)

    def rows(self, schema: pa.Schema, losses: list[str] | None = None) -> Batches:
        """Yield its rows a batch at a time, as those of its table.

        Args:
            schema: The columns wanted.
            losses: Takes what of the log cannot be read, in words.

        Raises:
            RecordingError: The file is damaged, or holds another table.
        """
        for batch in self.batches(schema.names, losses):
            try:
                yield conform(batch, schema)
            except ValueError as problem:
                raise RecordingError(self.path, str(problem)) from problem

    def schema(self) -> pa.Schema:
        """Return its columns as they are on disk.

        Raises:
            RecordingError: The file is damaged.
        """
        if self.closed:
            return parquet_schema(self.path)
        return self._logged_schema()

    def _logged_schema(self) -> pa.Schema:
        if (begin := first_begin(self.logged)) is None:
            return pa.schema([])
        return table_schema(self.table, begin.header.info.output_unit, begin.header.sensors)


def parquet_path(directory: Path, table: str, number: int) -> Path:
    """Return the path of a segment."""
    return directory / f"{table}-{number:04}.parquet"


def segments(directory: Path, info: SessionInfo, table: str | None = None) -> list[Segment]:
    """Return the segments of one table or of all, in their order.

    Args:
        directory: Directory of the session.
        info: Its facts.
        table: Name of the table, None for all.

    Raises:
        RecordingError: The folder of the log cannot be read.
    """
    tables = _ALL if table is None else (table,)
    every = (*_logged(directory, info, tables), *closed_segments(directory))
    found = {(one.number, one.table): one for one in every if one.table in tables}
    return sorted(found.values())


def write_segment(
    directory: Path,
    info: SessionInfo,
    part: int,
    rows_of: Callable[[str], Batches],
) -> SessionInfo:
    """Write a segment of each table, and count its rows and the times of its ticks.

    Args:
        directory: Directory of the session.
        info: Its facts.
        part: Number of the segment.
        rows_of: Returns the rows of a table.

    Returns:
        Its facts with the segment.

    Raises:
        RecordingError: Its rows cannot be read.
        OSError: It cannot be written.
    """
    rows = dict(info.rows)
    times = {name: list(info.histograms.get(name, [0] * BINS)) for name in _TIMES}
    for table in _ALL:
        counted = _counted(rows_of(table), table, rows, times)
        write_parquet(parquet_path(directory, table, part), counted)
    histograms = {name: tuple(counts) for name, counts in times.items()}
    return msgspec.structs.replace(info, segments=part, rows=rows, histograms=histograms)


def _counted(
    batches: Batches, table: str, rows: dict[str, int], times: dict[str, list[int]]
) -> Batches:
    for batch in batches:
        rows[table] = rows.get(table, 0) + batch.num_rows
        for name, counts in times.items() if table == TICKS else ():
            for time_us in batch.column(name).to_pylist():
                if not math.isnan(time_us):  # a stand-in tick has no turnaround
                    counts[bin_of(time_us)] += 1
        yield batch


def closed_segments(directory: Path) -> list[Segment]:
    """Return the Parquet files of a session, in their order."""
    return [
        Segment(int(match[2]), match[1], path)
        for path in sorted(directory.iterdir())
        if (match := _NAME.fullmatch(path.name))
    ]


def _logged(directory: Path, info: SessionInfo, tables: Iterable[str]) -> Iterator[Segment]:
    for part, group in groupby(unarchived(directory, info), key=lambda file: file.part):
        files = tuple(group)
        for table in tables:
            yield Segment(part, table, parquet_path(directory, table, part), files)
