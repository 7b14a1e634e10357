"""Times since the last report, as quantiles."""

from __future__ import annotations

import math
from collections import deque

from adaptdrive.runtime.reports import Quantiles

_LONGEST = 4096


class TimeWindow:
    """Collects times and gives their quantiles once."""

    def __init__(self) -> None:
        self._times_us: deque[float] = deque(maxlen=_LONGEST)

    def add(self, time_us: float) -> None:
        """Take in one time in microseconds."""
        self._times_us.append(time_us)

    def take(self) -> Quantiles:
        """Quantiles of the times since the last call; NaN when there were none."""
        times = sorted(self._times_us)
        self._times_us.clear()
        if not times:
            return Quantiles(math.nan, math.nan, math.nan)
        last = len(times) - 1
        return Quantiles(
            p50=times[round(0.50 * last)], p99=times[round(0.99 * last)], max=times[last]
        )
