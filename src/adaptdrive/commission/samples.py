"""Samples of an experiment, and means over parts of them."""

from __future__ import annotations

import bisect
import itertools
import math
import statistics
from dataclasses import dataclass, field

_NORMAL = 1.4826
"""Standard deviation over median deviation of a normal distribution."""


@dataclass(slots=True)
class Samples:
    """Boost voltage and output at increasing times.

    Attributes:
        times_s: Times.
        voltages_V: Boost voltages.
        outputs: Outputs.
        sums: Sum of the outputs before each, and of all.
    """

    times_s: list[float] = field(default_factory=list)
    voltages_V: list[float] = field(default_factory=list)
    outputs: list[float] = field(default_factory=list)
    sums: list[float] = field(default_factory=lambda: [0.0])

    def append(self, time_s: float, voltage_V: float, output: float) -> None:
        """Add a sample."""
        self.times_s.append(time_s)
        self.voltages_V.append(voltage_V)
        self.outputs.append(output)
        self.sums.append(self.sums[-1] + output)

    def count(self, from_s: float, to_s: float) -> int:
        """Return the number of samples after one time and until another."""
        return bisect.bisect(self.times_s, to_s) - bisect.bisect(self.times_s, from_s)

    def mean(self, from_s: float, to_s: float) -> float:
        """Return the mean output between two times, NaN where there is no sample."""
        first, last = bisect.bisect(self.times_s, from_s), bisect.bisect(self.times_s, to_s)
        return (self.sums[last] - self.sums[first]) / (last - first) if last > first else math.nan

    def reached_s(self, voltage_V: float, from_s: float) -> float:
        """Return when the boost voltage first reached a value after a time; that time if never."""
        for number in range(bisect.bisect(self.times_s, from_s), len(self.times_s)):
            if self.voltages_V[number] >= voltage_V:
                return self.times_s[number]
        return from_s

    def noise(self, from_s: float, to_s: float) -> float:
        """Return the standard deviation of the noise of one sample, from the differences.

        A slow movement does not count, and neither do spikes in less than half of the samples.
        """
        first, last = bisect.bisect(self.times_s, from_s), bisect.bisect(self.times_s, to_s)
        outputs = self.outputs[max(first, last - 2000) : last]
        steps = [abs(b - a) for a, b in itertools.pairwise(outputs)]
        if not steps:
            return 0.0
        middle = statistics.median(steps)
        robust = _NORMAL * middle / math.sqrt(2.0)
        # a coarse sensor repeats its value in most samples: then the mean square counts
        return robust or math.sqrt(statistics.fmean(step * step for step in steps) / 2.0)

    def resolution(self) -> float:
        """Return the smallest difference of two outputs in a row, 0 where all are the same."""
        steps = (abs(b - a) for a, b in itertools.pairwise(self.outputs))
        return min((step for step in steps if step > 0.0), default=0.0)

    def coarseness(self) -> float:
        """Return the resolution where it is larger than the noise, else 0."""
        if not self.outputs:
            return 0.0
        resolution = self.resolution()
        return resolution if resolution > self.noise(-math.inf, self.times_s[-1]) else 0.0
