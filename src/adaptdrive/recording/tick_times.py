"""Counts of rows and of the times of ticks, as `session.json` has them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import pyarrow as pa

from adaptdrive.recording.session import TICKS
from adaptdrive.runtime.statistics import BINS, bin_of

EVERY_TICK = "lateness_us"
"""The histogram that counts every tick: a stand-in tick has no turnaround."""

_TIMES = (EVERY_TICK, "turnaround_us", "tick_us")


class Counted:
    """Rows of tables, and the times of ticks by bin, counted as they are written.

    Attributes:
        rows: Rows by table.
        first_sequence: Running number of the first tick, 0 without one.
    """

    def __init__(
        self,
        rows: Mapping[str, int] | None = None,
        times: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        """Begin with what was counted before."""
        self.rows = dict(rows or {})
        self.first_sequence = 0
        self._times = {name: list((times or {}).get(name, [0] * BINS)) for name in _TIMES}

    @property
    def histograms(self) -> dict[str, tuple[int, ...]]:
        """Counts of lateness, turnaround and duration by bin."""
        return {name: tuple(counts) for name, counts in self._times.items()}

    def taken(self, table: str, batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        """Yield batches, and count them."""
        for batch in batches:
            if table == TICKS:
                if not self.rows.get(TICKS):
                    self.first_sequence = batch.column("sequence")[0].as_py()
                self._count_times(batch)
            self.rows[table] = self.rows.get(table, 0) + batch.num_rows
            yield batch

    def _count_times(self, ticks: pa.RecordBatch) -> None:
        """Count the times of some ticks; a stand-in tick has no turnaround."""
        for name, counts in self._times.items():
            for time_us in ticks.column(name).to_pylist():
                if not math.isnan(time_us):
                    counts[bin_of(time_us)] += 1
