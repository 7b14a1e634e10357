"""Times of ticks: quantiles since the last report, and a histogram since the start.

The bins of a histogram are powers of two: times below 1 us, below 2 us, below 4 us and so on, and
in the last bin those of 32,768 us or more. One late tick in a night is seen in it when every report
of that minute has long been overwritten.
"""

import math
from collections import deque

from adaptdrive.runtime.reports import Quantiles

BINS = 17
"""Powers of two from below 1 us to 32,768 us and more."""

_LONGEST = 4096
"""Times kept between two reports: 34 s at 120 Hz."""

_LARGEST_US = 1e9
"""Longest time that is counted as it is, 1,000 s, so that infinite ones have a bin."""


def bin_of(time_us: float) -> int:
    """The bin of a histogram that a time belongs to; anything below 1 us is in the first.

    Args:
        time_us: The time in microseconds.
    """
    return min(int(min(max(0.0, time_us), _LARGEST_US)).bit_length(), BINS - 1)


class TimeWindow:
    """Collects times: gives their quantiles once, and counts them for ever."""

    def __init__(self) -> None:
        self._times_us: deque[float] = deque(maxlen=_LONGEST)
        self._counts = [0] * BINS

    @property
    def histogram(self) -> tuple[int, ...]:
        """Counts of all times so far, by bin."""
        counts = self._counts.copy()
        for time_us in self._times_us:
            counts[bin_of(time_us)] += 1
        return tuple(counts)

    def add(self, time_us: float) -> None:
        """Take in one time in microseconds; it is counted later, outside the tick."""
        times = self._times_us
        if len(times) == _LONGEST:
            self._counts[bin_of(times[0])] += 1
        times.append(time_us)

    def take(self) -> Quantiles:
        """Quantiles of the times since the last call; NaN when there were none."""
        self._counts = list(self.histogram)
        times = sorted(self._times_us)
        self._times_us.clear()
        if not times:
            return Quantiles(math.nan, math.nan, math.nan)
        last = len(times) - 1
        return Quantiles(times[round(0.50 * last)], times[round(0.99 * last)], times[last])
