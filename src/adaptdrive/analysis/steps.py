"""Quality of control over a record: steps of the set-point, error, effort."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_STEP = 0.01
"""Smallest step that is judged, as a share of the set-points' range."""

_LEAST_PERIODS = 10
"""Slow periods for which a set-point must stay to be judged."""

_BAND = 0.05
"""Distance from the set-point, in steps, at which a response has settled."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of control; NaN where no step can be judged.

    Attributes:
        steps: Steps of the set-point that were judged.
        overshoot: Median overshoot, as a share of the step.
        settling_s: Median time to stay within 5 % of the step.
        unsettled: Steps that did not settle before the next one.
        error: Rms distance from the set-point.
        effort_V: Rms change of the boost voltage from one slow period to the next.
        highest_V: Largest mean boost voltage of a slow period.
    """

    steps: int
    overshoot: float
    settling_s: float
    unsettled: int
    error: float
    effort_V: float
    highest_V: float


def quality_of(
    reference: Array, output: Array, volts: Array, period_s: float, span: float
) -> Quality:
    """Judge means over slow periods.

    Args:
        reference: Set-point at the end of each slow period.
        output: Output, mean over each slow period.
        volts: Boost voltage, mean over each slow period.
        period_s: Slow period.
        span: Range of the set-points.
    """
    judged = [
        judge_step(output[first:last], reference[first - 1], reference[first])
        for first, last in _steps(reference, span)
    ]
    settled = [periods for _, periods in judged if math.isfinite(periods)]
    return Quality(
        steps=len(judged),
        overshoot=float(np.median([one for one, _ in judged])) if judged else math.nan,
        settling_s=float(np.median(settled)) * period_s if settled else math.nan,
        unsettled=len(judged) - len(settled),
        error=float(np.sqrt(np.mean((output - reference) ** 2))),
        effort_V=float(np.sqrt(np.mean(np.diff(volts) ** 2))) if len(volts) > 1 else math.nan,
        highest_V=float(volts.max()),
    )


def _steps(reference: Array, span: float) -> list[tuple[int, int]]:
    """Return first and last period of each set-point that was stepped to and held."""
    changes = np.flatnonzero(np.abs(np.diff(reference)) > 1e-9 * span) + 1
    ends = np.append(changes, len(reference))[1:]
    return [
        (int(first), int(last))
        for first, last in zip(changes, ends, strict=True)
        if last - first >= _LEAST_PERIODS
        and abs(reference[first] - reference[first - 1]) >= _LEAST_STEP * span
    ]


def judge_step(output: Array, before: float, after: float) -> tuple[float, float]:
    """Return overshoot and slow periods to settle, infinite where it does not.

    Args:
        output: From the step to the next one.
        before: Set-point before it.
        after: Set-point after it.
    """
    error = (output - after) / (after - before)
    outside = np.flatnonzero(np.abs(error) > _BAND)
    periods = float(outside[-1] + 1) if len(outside) else 0.0
    return max(0.0, float(error.max())), periods if periods < len(output) else math.inf


def period_means(values: Array, samples: int) -> Array:
    """Return means over slow periods, of the whole ones."""
    count = len(values) // samples
    return np.asarray(values[: count * samples].reshape(count, samples).mean(axis=1))
