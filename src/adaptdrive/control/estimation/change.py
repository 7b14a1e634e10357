"""Abrupt changes: how they are detected, and what may have moved in one.

The normalised innovation z² = ε² ρ / ((ρ + rᵀPr) σ²) of a settled estimate is about 1. A one-sided
cumulative sum (E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100)

    S <- max(0, S + z² - drift)          alarm when S > threshold, S = 0 after it

stays at 0 then, and reaches the threshold within a few samples of a change. σ² follows the median
of z² σ², which is 0.455 of the mean for Gaussian noise: a change moves it hardly, however large it
is. It has a floor against rounding and model error.

While an estimate is new, its innovations are a poor measure of σ². The noise of a sample shows in
their second differences, (ε[k] - 2 ε[k-1] + ε[k-2])² / 6 on average, whatever slow error is
under it.

Let θ jump by Δ at t0. The regression with the new θ then has the error e = y - rᵀθ = -r(t0)ᵀΔ at
t0, and (τ_λ p + 1)^m e = 0 from there on, because every term of it has passed the λ filters:

    e(t) = Σ c_i h^i e^-h      h = (t - t0)/τ_λ     c_i = -(1/i!) ((τ_λ p + 1)^i r)(t0)ᵀ Δ

These are the functions of the initial state, counted from t0. Their weights γ are therefore not
free: with a direction of Δ goes a direction of γ. (τ_λ p + 1) λ^j y is λ^(j-1) y, so that
(τ_λ p + 1) r is the regressor with every power of λ lowered by one.

A disturbance of the input moves the bias. A load that changes keeps its dc gain, and the offset of
its input: inertia, volume. Either may come with the other, and with another gain.
"""

import math
from dataclasses import dataclass

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import regression, rls
from adaptdrive.control.estimation.branch import Branch, Observation
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# Detection of an abrupt change from the innovations of the estimate.

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

LEAST_NOISE = 1e-2 * thresholds.NOISE_FLOOR
"""Least mean square of noise that is followed: a tenth of the deviation that the bank counts."""


@dataclass(slots=True)
class ChangeDetector:
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
    noise: float = thresholds.NOISE_FLOOR
    last: float = 0.0
    slope: float = 0.0


def noise_power(state: ChangeDetector, rounding: float) -> float:
    """Return σ², at least the variance of the rounding error of a sample."""
    return max(thresholds.NOISE_FLOOR, state.power, rounding * rounding)


def is_change(state: ChangeDetector, squared: float, power: float) -> bool:
    """Return whether the load has just changed.

    Args:
        state: Overwritten.
        squared: ε² ρ / (ρ + rᵀPr), scaled.
        power: σ² of this sample, from `noise_power`.
    """
    state.samples += 1
    if state.samples <= thresholds.WINDOW:
        state.power = max(thresholds.NOISE_FLOOR, state.noise)
        return False
    ratio = squared / power
    state.power = max(thresholds.NOISE_FLOOR, move_median(state.power, squared, _SLOW_RATE))
    state.sum = max(0.0, state.sum + ratio - DRIFT)
    if state.sum <= THRESHOLD:
        return False
    state.sum = 0.0
    state.alarms += 1
    return True


def track_noise(state: ChangeDetector, innovation: float) -> None:
    """Follow the noise of a sample, which no slow error hides.

    Args:
        state: Overwritten.
        innovation: ε, scaled.
    """
    slope = innovation - state.last
    bend = slope - state.slope
    squared = bend * bend / 6.0  # a power would raise where it overflows
    state.last, state.slope = innovation, slope
    rate = _FAST_RATE if state.samples <= thresholds.WINDOW else _SLOW_RATE
    state.noise = max(LEAST_NOISE, move_median(state.noise, squared, rate))


def move_median(power: float, squared: float, rate: float) -> float:
    """Move a mean square so that its median is that of Gaussian noise."""
    return power * (1.0 + (rate if squared > _MEDIAN * power else -rate))


# What may have moved, as directions in which θ becomes uncertain.

DISTURBANCE = 1
LOAD = 2
ANEW = 3

ODDS_AGAINST = {
    DISTURBANCE: thresholds.RARE,
    LOAD: thresholds.RARE + thresholds.RARER,
    ANEW: thresholds.RARE + 2.0 * thresholds.RARER,
}
"""Log odds against each at an alarm."""

DISTURBANCE_SHARE = 0.1
"""Deviation of a disturbance, of the input's scale: 30 V of 300 V."""

_TINY = 1e-12
"""Divisor that counts as 0: 4,500 rounding errors of 1."""


@dataclass(slots=True)
class ChangePoint:
    """The last sample before a change.

    Attributes:
        regressor: r.
        lowered: r with every power of λ lowered by one.
        time_s: t0.
        power: σ² of the innovations.
        gap_s: From there to the first sample after the change.
    """

    regressor: Vector
    lowered: Vector
    time_s: float = 0.0
    power: float = 0.0
    gap_s: float = 0.0


def note_sample(point: ChangePoint, sample: Observation) -> None:
    """Remember a sample: the next one may be the first after a change."""
    vectors.copy_into(point.regressor, sample.regressor)
    vectors.copy_into(point.lowered, sample.lowered)
    point.time_s = sample.time_s


def restart_past(branch: Branch, learning: EstimatorSettings, load: Load, time_s: float) -> None:
    """Count the functions of the initial state from another time; θ and P follow.

    Args:
        branch: θ, P and origin, overwritten.
        learning: τ_λ.
        load: Order.
        time_s: The new origin, not before the old one.
    """
    size, count = len(branch.theta), regression.initial_state_count(learning, load)
    first = regression.fitted_order(learning, load) + len(load.input_powers)
    shift = (time_s - branch.origin_s) / learning.tau_lambda_s
    change = _shifted_functions(count, shift)
    transform = vectors.identity(size)
    for i in range(count):
        for j in range(count):
            transform[(first + i) * size + first + j] = change[i * count + j]
    old = list(branch.theta)
    for i in range(size):
        branch.theta[i] = vectors.dot(transform[i * size : (i + 1) * size], old)
    rls.transform(branch.upper, branch.diagonal, transform)
    branch.origin_s = time_s


def _shifted_functions(count: int, shift: float) -> Vector:
    """Weights of h^i e^-h that make of Σ γ_j (h + s)^j e^-(h + s) the same course."""
    weights = [0.0] * (count * count)
    decay = math.exp(-shift)
    for j in range(count):
        factor = decay  # C(j, i) s^(j - i) e^-s, from i = j down
        for i in range(j, -1, -1):
            weights[i * count + j] = factor
            factor *= shift * i / (j - i + 1)
    return weights


def widen(
    branch: Branch, kind: int, learning: EstimatorSettings, load: Load, point: ChangePoint
) -> None:
    """Open an estimate up for what a kind of change may have moved.

    Args:
        branch: P is overwritten.
        kind: DISTURBANCE, LOAD, or ANEW for both, another gain and the state of the load.
        learning: Scales.
        load: Order and structure.
        point: The last sample before the change.
    """
    order, size = regression.fitted_order(learning, load), len(branch.theta)
    last = order + len(load.input_powers) - 1
    gains = abs(vectors.total(branch.theta[order : last + 1]))
    if kind != LOAD and learning.bias:
        direction = vectors.unit(size, size - 1)
        _open(branch, direction, DISTURBANCE_SHARE * gains, learning, load, point)
    if kind != DISTURBANCE:
        _widen_load(branch, learning, load, point)
    if kind == ANEW:
        direction = [0.0] * size
        direction[order : last + 1] = branch.theta[order : last + 1]
        _carry_offset(direction, branch.theta, 1.0, learning)
        _open(branch, direction, thresholds.PRIOR_SHARE, learning, load, point)
    share = min(1.0, point.gap_s / learning.tau_lambda_s)  # the moment of the change is in doubt
    spread = DISTURBANCE_SHARE * gains
    _widen_state(branch, share * share * spread * spread / point.power, learning, load)
    if kind == ANEW:  # a disk that lands at rest takes half the speed away
        _widen_state(
            branch, thresholds.PRIOR_SHARE * thresholds.PRIOR_SHARE / point.power, learning, load
        )


def _widen_load(
    branch: Branch, learning: EstimatorSettings, load: Load, point: ChangePoint
) -> None:
    """Other dynamics with the same dc gain and the same offset of the input."""
    for i in range(regression.fitted_order(learning, load) + len(load.input_powers) - 1):
        direction = load_direction(branch.theta, i, learning, load)
        _open(branch, direction, thresholds.PRIOR_SHARE, learning, load, point)


def load_direction(theta: Vector, index: int, learning: EstimatorSettings, load: Load) -> Vector:
    """Return a direction of θ that leaves the dc gain and the offset of the input as they are.

    Args:
        theta: θ.
        index: Of the coefficient that changes by 1: one of α, or of β but the last.
        learning: Scales.
        load: Order and structure.
    """
    order, size = regression.fitted_order(learning, load), len(theta)
    last = order + len(load.input_powers) - 1
    direction = vectors.unit(size, index)
    if index >= order:
        direction[last] = -1.0
        return direction
    direction[last] = regression.dc_gain(theta, learning, load)
    below = 1.0
    for i in range(order):
        below += theta[i]
    if abs(below) > _TINY:
        _carry_offset(direction, theta, below, learning)
    return direction


def _carry_offset(
    direction: Vector, theta: Vector, divisor: float, learning: EstimatorSettings
) -> None:
    """Let what acts with the input move with the gain: bias and charge, over a divisor."""
    size = len(theta)
    if learning.bias:
        direction[size - 1] = theta[size - 1] / divisor
    if learning.charge:
        index = regression.charge_index(learning, size)
        direction[index] = theta[index] / divisor


def _open(
    branch: Branch,
    direction: Vector,
    spread: float,
    learning: EstimatorSettings,
    load: Load,
    point: ChangePoint,
) -> None:
    """Widen P by a spread along a direction of θ and along what goes with it in γ, at least one."""
    size, count = len(direction), regression.initial_state_count(learning, load)
    first = regression.fitted_order(learning, load) + len(load.input_powers)
    plain, lowered = 0.0, 0.0
    for i in range(size):
        if not first <= i < first + count:
            plain += point.regressor[i] * direction[i]
            lowered += point.lowered[i] * direction[i]
    direction[first] = -plain
    if count > 1:
        direction[first + 1] = -lowered
    rls.widen(branch.upper, branch.diagonal, direction, spread * spread / point.power)


def _widen_state(branch: Branch, variance: float, learning: EstimatorSettings, load: Load) -> None:
    """Widen γ, what is left of the state at the change, by itself."""
    first = regression.fitted_order(learning, load) + len(load.input_powers)
    for i in range(regression.initial_state_count(learning, load)):
        direction = vectors.unit(len(branch.theta), first + i)
        rls.widen(branch.upper, branch.diagonal, direction, variance)
