"""Histograms of the times of ticks, as `session.json` has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pyarrow as pa

from adaptdrive.runtime.statistics import BINS, bin_of

EVERY_TICK = "lateness_us"
"""The histogram that counts every tick: a stand-in tick has no turnaround."""

_TIMES = (EVERY_TICK, "turnaround_us", "tick_us")


class TickTimes:
    """Counts of lateness, turnaround and duration by bin."""

    def __init__(self, counted: Mapping[str, Sequence[int]] | None = None) -> None:
        known = counted or {}
        self._counts = {name: list(known.get(name, [0] * BINS)) for name in _TIMES}

    @property
    def histograms(self) -> dict[str, tuple[int, ...]]:
        """Counts by bin."""
        return {name: tuple(counts) for name, counts in self._counts.items()}

    def count(self, ticks: pa.RecordBatch) -> None:
        """Count the times of some ticks; a stand-in tick has no turnaround."""
        for name, counts in self._counts.items():
            for time_us in ticks.column(name).to_pylist():
                if not math.isnan(time_us):
                    counts[bin_of(time_us)] += 1
