"""Detection of an abrupt change of the load from the innovations of the estimator.

The normalised innovation z² = ε² ρ / ((ρ + rᵀPr) σ²) of a settled estimate is about 1. A one-sided
cumulative sum (E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100)

    S <- max(0, S + z² - drift)          alarm when S > threshold, S = 0 after it

stays at 0 then, and reaches the threshold within a few samples of a change. The last sample at
which it was 0 is Page's estimate of the change. σ² follows the median of z² σ², which is 0.455 of
the mean for Gaussian noise: a change moves it hardly, however large it is. It has a floor against
rounding and model error.

While an estimate is new, its innovations are a poor measure of σ². The noise of a sample shows in
their second differences, (ε[k] - 2 ε[k-1] + ε[k-2])² / 6 on average, whatever slow error is
under it.
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control.thresholds import NOISE_FLOOR, WINDOW

DRIFT = 3.0
"""Subtracted from each z²: the sum rises only while z² is larger than three times its mean."""

THRESHOLD = 9.0
"""One z² above 12, or several smaller ones in a row: rare with noise alone."""

_FAST_RATE = 0.3
"""Rate of the median after a start: within a factor of 2 after about 3 samples."""

_SLOW_RATE = 0.03
"""Rate of the median later: a factor of 2 takes 25 samples, longer than a comparison."""

_MEDIAN = 0.455
"""Median over mean of the square of Gaussian noise (χ² with one degree of freedom)."""

LEAST_NOISE = 1e-2 * NOISE_FLOOR
"""Least mean square of noise that is followed: a tenth of the deviation that explanations count."""


@dataclass(slots=True)
class Surprise:
    """State of the detector of abrupt changes.

    Attributes:
        power: σ², of the innovations in units of the scaled output.
        sum: S.
        samples: Samples seen.
        alarms: Alarms so far.
        noise: Mean square of the noise of a sample, from second differences.
        last: ε of the last sample.
        slope: Difference of the last two.
    """

    power: float = 0.0
    sum: float = 0.0
    samples: int = 0
    alarms: int = 0
    noise: float = NOISE_FLOOR
    last: float = 0.0
    slope: float = 0.0


def is_surprising(state: Surprise, squared: float) -> bool:
    """Return whether the load has just changed.

    Args:
        state: Overwritten.
        squared: ε² ρ / (ρ + rᵀPr), scaled.
    """
    state.samples += 1
    if state.samples <= WINDOW:
        state.power = max(NOISE_FLOOR, state.noise)
        return False
    ratio = squared / state.power
    state.power = max(NOISE_FLOOR, move_median(state.power, squared, _SLOW_RATE))
    state.sum = max(0.0, state.sum + ratio - DRIFT)
    if state.sum <= THRESHOLD:
        return False
    state.sum = 0.0
    state.alarms += 1
    return True


def watch_noise(state: Surprise, innovation: float) -> None:
    """Follow the noise of a sample, which no slow error hides.

    Args:
        state: Overwritten.
        innovation: ε, scaled.
    """
    slope = innovation - state.last
    bend = slope - state.slope
    squared = bend * bend / 6.0  # a power would raise where it overflows
    state.last, state.slope = innovation, slope
    rate = _FAST_RATE if state.samples <= WINDOW else _SLOW_RATE
    state.noise = max(LEAST_NOISE, move_median(state.noise, squared, rate))


def move_median(power: float, squared: float, rate: float) -> float:
    """Move a mean square so that its median is that of Gaussian noise."""
    return power * (1.0 + (rate if squared > _MEDIAN * power else -rate))
