"""The screen in front of the filters: spikes are clipped, honest changes pass.

A tracker predicts each fast sample from level and slope (an α-β filter) and keeps the mean
absolute deviation s of the samples from their prediction:

    e = y - (ŷ + v)          e_c = e clipped to ± c s
    ŷ <- ŷ + v + α e_c       v <- v + β e_c       s <- s + γ n (min(|e|, 2 c s) - s)

The sample passed on is ŷ + v + e_c; n is the number of ticks since the last one. A spike counts
as c deviations and no more. A change lasts: the fifth sample in a row beyond the same limit opens
the screen to its own deviation, however narrow the screen had become at a standstill. For Gaussian
noise s is 0.8 σ.
(Huber, Ann. Math. Statist. 35, 1964, doi:10.1214/aoms/1177703732.)
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control.evidence import PRIOR_SAMPLES

ALPHA = 0.1
"""Gain on the level: it follows a change within about 10 samples."""

BETA = ALPHA * ALPHA / (2.0 - ALPHA)
"""Gain on the slope: the tracker is damped by 0.71 then (T. R. Benedict and G. W. Bordner, IRE
Transactions on Automatic Control 7, 1962)."""

GAMMA = 0.02
"""Rate of the mean deviation: a mean over about 50 ticks."""

_GAMMA_MAX = 1.0 / PRIOR_SAMPLES
"""Largest share of one sample in the mean deviation: fewer samples are no mean."""

WIDE = 0.01
"""Deviation to start with, as a share of the output: wide enough for an honest first second."""

LASTING = 5
"""Samples in a row beyond one limit that are a change, not spikes."""


@dataclass(slots=True)
class Screen:
    """State of the screen.

    Attributes:
        level: ŷ.
        slope: v, per tick.
        deviation: s.
        beyond: Samples in a row beyond the upper limit, negative for the lower one.
    """

    level: float
    slope: float
    deviation: float
    beyond: int = 0


def pass_sample(
    screen: Screen, sample: float, clip: float, ticks: int, least: float = 0.0
) -> float:
    """One fast sample, clipped.

    Args:
        screen: Overwritten.
        sample: y.
        clip: c.
        ticks: n: a drive that is polled has one sample in several ticks.
        least: Least deviation: a noiseless output must not close the screen.
    """
    predicted = screen.level + screen.slope
    error = sample - predicted
    limit = _limit(screen, error, clip)
    kept = min(max(error, -limit), limit)
    screen.level = predicted + ALPHA * kept
    screen.slope += BETA * kept
    seen = min(abs(error), 2.0 * limit)
    share = min(GAMMA * ticks, _GAMMA_MAX)
    screen.deviation = max(least, screen.deviation + share * (seen - screen.deviation))
    return predicted + kept


def _limit(screen: Screen, error: float, clip: float) -> float:
    """Return the largest deviation that passes, opened for a change that lasts."""
    limit = clip * screen.deviation
    if abs(error) <= limit:
        screen.beyond = 0
        return limit
    if error > 0.0:
        screen.beyond = max(screen.beyond, 0) + 1
    else:
        screen.beyond = min(screen.beyond, 0) - 1
    if abs(screen.beyond) < LASTING:
        return limit
    screen.beyond = 0
    screen.deviation = abs(error) / clip
    return abs(error)
