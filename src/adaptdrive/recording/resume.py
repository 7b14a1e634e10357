"""Continuation of an interrupted session without writing again the rows on disk."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from adaptdrive.errors import RecordingError
from adaptdrive.recording.segments import Segment, newest_number, segments
from adaptdrive.recording.session import SENSORS, SLOW, TICKS, SessionInfo
from adaptdrive.recording.tick_times import TickTimes, has_times

KEYS = {TICKS: "sequence", SLOW: "monotonic_s", SENSORS: "monotonic_s"}
"""The column of each table that only ever grows."""


@dataclass(frozen=True, slots=True)
class Written:
    """Rows that a session already contains.

    Attributes:
        segment: Number of the last segment, 0 for none.
        last: Last value of the key column by table.
        times: Histograms of all ticks.
        rows: Rows by table.
    """

    segment: int = 0
    last: dict[str, float] = field(default_factory=dict)
    times: TickTimes = field(default_factory=TickTimes)
    rows: dict[str, int] = field(default_factory=dict)

    def count(self, table: str, batch: pa.RecordBatch) -> None:
        """Count rows that are on disk now."""
        self.rows[table] = self.rows.get(table, 0) + batch.num_rows
        if table == TICKS:
            self.times.count(batch)


def find_written(directory: Path, info: SessionInfo) -> Written:
    """Read the end of what was written before.

    Args:
        directory: Directory of the session.
        info: Its facts; of the segments that it counts, only the last ones with a row are read.

    Raises:
        RecordingError: A segment is damaged, or holds another table.
    """
    found = segments(directory)
    written = Written(
        newest_number(found),
        times=TickTimes(info.histograms),
        rows=dict(info.rows),
    )
    for segment in found:
        if segment.number > info.segments or not info.histograms:
            _count(segment, written)
    for segment in reversed(found):  # the newest has no row where it broke off at its begin
        if segment.table not in written.last:
            _find_last(segment, written)
    return written


def _count(segment: Segment, written: Written) -> None:
    """Count the rows of a segment, and note its last one."""
    for batch in segment.batches():
        if segment.table == TICKS and not has_times(batch):
            raise RecordingError(segment.path, "it does not hold the times of each tick")
        written.count(segment.table, batch)
        _note_last(segment, batch, written)


def _find_last(segment: Segment, written: Written) -> None:
    """Note the last row of a segment, if it has one."""
    for batch in segment.batches():
        _note_last(segment, batch, written)


def _note_last(segment: Segment, batch: pa.RecordBatch, written: Written) -> None:
    if batch.num_rows and KEYS[segment.table] in batch.schema.names:
        written.last[segment.table] = last_key(segment, batch)


def last_key(segment: Segment, batch: pa.RecordBatch) -> float:
    """Return the value of the key column in the last row of a batch.

    Args:
        segment: The segment that the batch is from.
        batch: One row or more.

    Raises:
        RecordingError: The segment has no such column, or no number in it.
    """
    key = KEYS[segment.table]
    if batch.schema.names.count(key) == 1:
        last = batch.column(key)[-1].as_py()
        if isinstance(last, int if segment.table == TICKS else float):
            return last
    raise RecordingError(segment.path, f"it does not hold the {key} of each row")


def after(batch: pa.RecordBatch, table: str, last: dict[str, float]) -> pa.RecordBatch:
    """Return the rows of a batch that are not on disk yet."""
    if table not in last:
        return batch
    keys = batch.column(KEYS[table]).to_pylist()
    first = next((row for row, key in enumerate(keys) if key > last[table]), len(keys))
    return batch.slice(first)
