"""The resolution of the sensor, found in its own samples, and the rounding error that it leaves.

The differences of the samples of a rounded output are whole multiples of one step q. Each
difference d > 0 of two successive samples is compared with the multiples of a candidate:

    k = round(d / q)      agrees: k >= 1 and |d / q - k| <= tolerance      else: k q - d remains

A candidate counts once enough differences agreed. One with which several do not agree is replaced
by what remained of the last, as in Euclid's algorithm; below the finest step that matters the
search begins again. A candidate outlives single samples off the steps. Samples that are not
rounded, or to steps far below the noise that is always counted with, give no step.

Rounding errs by q/√12 while the output stands still. Noise of a deviation σ before it spreads the
samples over several steps, whose mean errs less, by exp(-2 π² σ²/q²) (B. Widrow and I. Kollár,
Quantization Noise, 2008, chapter 4). σ shows in the share p of the samples that differ from the
one before: two samples differ by 2 σ/√π on average, which is p q as long as p is small. The result
is at most a sixth of q/√12 too large.

    rounding error = q/√12 exp(-π³ p²/2)
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

from adaptdrive.control.evidence import MEMORY, NOISE_FLOOR

FINEST = math.sqrt(NOISE_FLOOR)
"""Smallest step that is looked for: the rounding error of smaller ones is far below least noise."""

COARSEST = 0.05
"""Largest step that is believed: such a sensor shows twenty values up to the scale."""

TOLERANCE = 0.02
"""Distance from a multiple, in steps: more than single precision leaves of the finest step."""

_FOUND = math.ceil(math.log(sys.float_info.epsilon) / math.log(2.0 * TOLERANCE))
"""Differences that must agree: without steps each does by a chance of twice the tolerance, and all
of them by less than the rounding of a double."""

_MISS = _FOUND // 3
"""Weight of a difference that does not agree, which by chance only one of 25 does: three refute a
step that has just been found."""

_SURE = _FOUND + 2 * _MISS
"""Differences that are counted: a sample off the steps makes two that do not agree, after which
the step is still found."""

_LARGEST_MULTIPLE = 1.0e6
"""Steps in a difference: more no sensor shows, and an infinite number of them has no multiple."""


@dataclass(slots=True)
class Grid:
    """State of the search for the step of a sensor.

    Attributes:
        last: Last sample; NaN where only the step is known.
        candidate: Step that is being tried, in the unit of the output; 0 for none.
        score: Differences that agreed with it, less those that did not.
        changes: Ticks of the slow period so far whose sample differs from the one before.
        share: p, over the slow periods so far.
        periods: Slow periods in it, up to its memory.
    """

    last: float
    candidate: float = 0.0
    score: int = 0
    changes: int = 0
    share: float = 0.0
    periods: float = 0.0


def remembered_grid(step: float) -> Grid:
    """Return a search that begins with the step that an earlier run has found, 0 for none."""
    return Grid(math.nan, step, _SURE) if step > 0.0 else Grid(0.0)


def note_sample(grid: Grid, sample: float, scale: float, ticks: int = 1) -> None:
    """Compare a raw sample with the one before it.

    Args:
        grid: Overwritten.
        sample: y as the sensor gave it.
        scale: Output of order one.
        ticks: Half line cycles since the last sample: more than 1 where a drive is polled.
    """
    if sample == grid.last:
        return
    difference = abs(sample - grid.last)
    grid.last = sample
    grid.changes += ticks
    finest = FINEST * scale
    if not grid.candidate > 0.0:
        grid.candidate = difference if finest <= difference < 1.0 / FINEST * scale else 0.0
        return
    ratio = difference / grid.candidate
    if not ratio < _LARGEST_MULTIPLE:
        return
    multiple = math.floor(ratio + 0.5)
    rest = abs(ratio - multiple)
    if multiple >= 1 and rest <= TOLERANCE:
        grid.score = min(grid.score + 1, _SURE)
        return
    grid.score -= _MISS
    if grid.score < 0:
        remains = rest * grid.candidate
        grid.candidate, grid.score = (remains if remains >= finest else 0.0), 0


def step_found(grid: Grid, scale: float) -> float:
    """Return the step of the sensor in the unit of the output, 0 while none is known.

    Args:
        grid: What the samples showed.
        scale: Output of order one.
    """
    if grid.score < _FOUND or grid.candidate > COARSEST * scale:
        return 0.0
    return grid.candidate


def close_share(grid: Grid, ticks: int) -> None:
    """Take the changes of a slow period into their share.

    Args:
        grid: Overwritten.
        ticks: Half line cycles of the period.
    """
    grid.periods = min(grid.periods + 1.0, MEMORY)
    grid.share += (min(1.0, grid.changes / ticks) - grid.share) / grid.periods
    grid.changes = 0


def rounding_error(step: float, share: float) -> float:
    """Return the standard deviation of the rounding error of a slow sample.

    Args:
        step: q, in the unit of the output.
        share: p.
    """
    return step / math.sqrt(12.0) * math.exp(-0.5 * math.pi**3 * share * share)
