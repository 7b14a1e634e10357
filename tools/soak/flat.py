"""Whether a figure that is measured again and again stays what it is: a robust slope.

The slope is the median of the slopes between all pairs of samples (Theil and Sen): single peaks, a
collection of garbage or a segment that is closed do not move it. The first quarter is left out: an
interpreter that starts is not flat.
"""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

WARM_UP = 0.25
"""Share of the samples that are left out."""

MOST_PAIRED = 300
"""Samples of which all pairs are looked at; of more, evenly spread ones."""


@dataclass(frozen=True, slots=True)
class Limit:
    """What a figure may gain over a run.

    Attributes:
        share: Of its median.
        absolute: In its unit, where that is more.
    """

    share: float = 0.0
    absolute: float = 0.0

    def of(self, median: float) -> float:
        """Return the limit of a figure with a median."""
        return max(self.share * median, self.absolute)


MEMORY_MiB = Limit(share=0.03, absolute=2.0)
OBJECTS = Limit(share=0.01, absolute=2000.0)
COUNT = Limit(absolute=0.5)
"""Descriptors and threads: not one more."""


@dataclass(frozen=True, slots=True)
class Trend:
    """A figure over a run.

    Attributes:
        first: First sample after the warm-up.
        median: Of the samples after the warm-up.
        last: Last sample.
        gain: Slope times the time after the warm-up.
        per_hour: Slope.
        limit: Largest gain of a flat figure.
    """

    first: float
    median: float
    last: float
    gain: float
    per_hour: float
    limit: float

    @property
    def flat(self) -> bool:
        """True where it gains no more than its limit."""
        return self.gain <= self.limit


def trend(hours: Sequence[float], values: Sequence[float], limit: Limit) -> Trend:
    """Return the trend of a figure.

    Args:
        hours: When each sample was taken.
        values: The samples.
        limit: What it may gain.

    Raises:
        ValueError: There are fewer than eight samples, of which nothing can be said.
    """
    if len(values) < 8:
        raise ValueError(f"{len(values)} samples say nothing")
    start = int(WARM_UP * len(values))
    kept = list(zip(hours, values, strict=True))[start:]
    slope = statistics.median(_slopes(kept))
    median = statistics.median(value for _, value in kept)
    gain = slope * (kept[-1][0] - kept[0][0])
    return Trend(kept[0][1], median, kept[-1][1], gain, slope, limit.of(median))


def _slopes(samples: Sequence[tuple[float, float]]) -> list[float]:
    step = 1 + len(samples) // MOST_PAIRED
    pairs = itertools.combinations(samples[::step], 2)
    return [(after - before) / (then - now) for (now, before), (then, after) in pairs if then > now]
