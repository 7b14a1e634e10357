"""Detection of an abrupt change of the load from the innovations of the estimator.

The normalised innovation z² = ε² ρ / ((ρ + rᵀPr) σ²) of a settled estimate is about 1. A one-sided
cumulative sum (E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100)

    S <- max(0, S + min(z², z²_max) - drift)          alarm when S > threshold

stays at 0 then, and reaches the threshold within a few samples of a change. The alarm opens the
estimator up, so that the new load is learnt from the samples after the change instead of waiting
for the old ones to be forgotten. σ² is a slow mean of z² σ²; it hardly moves while S is not at
rest, has a floor against rounding and model error, and is learnt afresh after a start.
"""

from __future__ import annotations

from dataclasses import dataclass

DRIFT = 3.0
"""Subtracted from each z²: the sum rises only while z² is larger than three times its mean."""

LARGEST = 20.0
"""Largest z² that counts: one sample adds at most 17 to the sum."""

THRESHOLD = 6.0
"""One z² above 9, or several smaller ones in a row; chosen by campaigns."""

SETTLE_PERIODS = 40
"""Slow periods after a start in which the variance is measured and no alarm is given."""

HOLD_PERIODS = 30
"""Slow periods after an alarm without another one, in which the estimate converges."""

SOON_PERIODS = 10
"""Slow periods after that in which an alarm counts as a repetition."""

_FLOOR = 1.0e-8
"""Least variance: a ten-thousandth of the scale, squared, for rounding and model error."""

_FAST_RATE = 0.1
"""Rate of the variance after a start: a mean over about 10 periods."""

_SLOW_RATE = 0.01
"""Rate of the variance later: a mean over about 100 periods."""

_SLOW_LARGEST = 4.0
"""Largest z² in that mean: one outlier raises the variance by 3 % at most."""


@dataclass(slots=True)
class Surprise:
    """State of the detector of abrupt changes.

    Attributes:
        power: σ², mean square of the innovations in units of the scaled output.
        sum: S.
        periods: Samples seen.
        held_periods: Samples until the next alarm may be given.
        alarms: Alarms so far.
        calm_periods: Samples since the last alarm.
        repeated: Whether the last alarm came soon after the one before.
    """

    power: float = 0.0
    sum: float = 0.0
    periods: int = 0
    held_periods: int = 0
    alarms: int = 0
    calm_periods: int = 0
    repeated: bool = False


def is_surprising(state: Surprise, squared: float) -> bool:
    """Return whether the load has just changed.

    Args:
        state: Overwritten.
        squared: ε² ρ / (ρ + rᵀPr), scaled.
    """
    state.periods += 1
    state.calm_periods += 1
    state.held_periods = max(0, state.held_periods - 1)
    if state.periods <= SETTLE_PERIODS:
        first = state.periods == 1
        rate = 1.0 if first else _FAST_RATE
        state.power = max(_FLOOR, state.power + rate * (squared - state.power))
        return False
    ratio = squared / state.power
    state.sum = max(0.0, state.sum + min(ratio, LARGEST) - DRIFT)
    change = _SLOW_RATE * (min(ratio, _SLOW_LARGEST) - 1.0)
    state.power = max(_FLOOR, state.power * (1.0 + change))
    if state.sum <= THRESHOLD or state.held_periods > 0:
        return False
    state.sum = 0.0
    state.repeated = state.alarms > 0 and state.calm_periods <= HOLD_PERIODS + SOON_PERIODS
    state.held_periods = HOLD_PERIODS
    state.calm_periods = 0
    state.alarms += 1
    return True
