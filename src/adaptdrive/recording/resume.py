"""Continuation of an interrupted session without writing again the rows on disk."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from adaptdrive.recording.segments import Segment, segments
from adaptdrive.recording.session import SENSORS, SLOW, TICKS, SessionInfo
from adaptdrive.recording.tick_times import TickTimes

KEYS = {TICKS: "sequence", SLOW: "monotonic_s", SENSORS: "monotonic_s"}
"""The column of each table that only ever grows."""


@dataclass(frozen=True, slots=True)
class Written:
    """Rows that a session already contains.

    Attributes:
        segment: Number of the last segment, 0 for none.
        last: Last value of the key column by table.
        times: Histograms of all ticks.
    """

    segment: int = 0
    last: dict[str, float] = field(default_factory=dict)
    times: TickTimes = field(default_factory=TickTimes)


def find_written(directory: Path, info: SessionInfo) -> Written:
    """Read the end of what was written before.

    Args:
        directory: Directory of the session.
        info: Its facts; only segments that its histograms lack are read.
    """
    found = segments(directory)
    times, last = TickTimes(info.histograms), dict[str, float]()
    newest = {segment.table: segment.number for segment in found}
    for segment in found:
        counted = segment.number <= info.segments and bool(info.histograms)
        uncounted = segment.table == TICKS and not counted
        if uncounted or segment.number == newest[segment.table]:
            _read(segment, times if uncounted else None, last)
    return Written(max(newest.values(), default=0), last, times)


def _read(segment: Segment, times: TickTimes | None, last: dict[str, float]) -> None:
    for batch in segment.batches():
        if times is not None:
            times.count(batch)
        if batch.num_rows and KEYS[segment.table] in batch.schema.names:
            last[segment.table] = batch.column(KEYS[segment.table])[-1].as_py()


def after(batch: pa.RecordBatch, table: str, last: dict[str, float]) -> pa.RecordBatch:
    """Return the rows of a batch that are not on disk yet."""
    if table not in last:
        return batch
    keys = batch.column(KEYS[table]).to_pylist()
    first = next((row for row, key in enumerate(keys) if key > last[table]), len(keys))
    return batch.slice(first)
