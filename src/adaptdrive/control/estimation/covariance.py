"""The covariance P of an estimate: deviations of physical parameters, and its jumps.

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
from adaptdrive.control.estimation.branch import Branch
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# Standard deviations of the physical parameters of a load, from an estimate and its P.

_TINY = 1e-12
"""Divisor that counts as 0: 4,500 rounding errors of 1."""


def is_sure(branch: Branch, power: float, learning: EstimatorSettings, load: Load) -> bool:
    """Return whether every physical parameter is known within half of its value.

    Args:
        branch: θ and P.
        power: σ², scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
    """
    numerator, denominator = regression.filtered_model(branch.theta, learning, load)
    if vectors.lacks(abs(denominator[load.order]), _TINY):
        return False
    values = load.physical(numerator, denominator)
    deviations = deviations_of(branch, math.sqrt(power), learning, load, values)
    return all(deviations[i] <= thresholds.PRIOR_SHARE * abs(values[i]) for i in range(len(values)))


def deviations_of(
    branch: Branch, noise: float, learning: EstimatorSettings, load: Load, values: Vector
) -> Vector:
    """Standard deviations of the physical parameters at any θ and P, to first order.

    Args:
        branch: θ and P.
        noise: σ of the innovations, scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    count, rows = len(branch.theta), _jacobian(branch.theta, learning, load, values)
    deviations = [math.nan] * len(values)
    if not math.isfinite(rows[0]):
        return deviations
    for i in range(len(values)):
        row = rows[i * count : (i + 1) * count]
        deviations[i] = rls.standard_deviation(row, branch.upper, branch.diagonal, noise)
    return deviations


def root_of(
    branch: Branch, noise: float, learning: EstimatorSettings, load: Load, values: Vector
) -> Vector:
    """L, lower triangular, flat, of the covariance L Lᵀ of the physical parameters.

    Args:
        branch: θ and P.
        noise: σ of the innovations, scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    size, count = len(values), len(branch.theta)
    rows = _jacobian(branch.theta, learning, load, values)
    known = rls.covariance(branch.upper, branch.diagonal)
    root = [0.0] * (size * size)
    for i in range(size):
        for j in range(i + 1):
            rest = 0.0
            for m in range(count):
                for n in range(count):
                    rest += rows[i * count + m] * known[m * count + n] * rows[j * count + n]
            rest *= noise * noise
            whole = rest
            for m in range(j):
                rest -= root[i * size + m] * root[j * size + m]
            if i == j:
                root[i * size + i] = math.sqrt(rest) if not rest < _TINY * whole else 0.0
            elif root[j * size + j] > 0.0:
                root[i * size + j] = rest / root[j * size + j]
    return root


def _jacobian(theta: Vector, learning: EstimatorSettings, load: Load, values: Vector) -> Vector:
    """Derivatives of the physical parameters by θ, a row for each; NaN without a dc gain."""
    count = len(theta)
    rows = [0.0] * (len(values) * count)
    for j in range(count):
        step = 1e-6 * max(1.0, abs(theta[j]))
        moved = list(theta)
        moved[j] += step
        numerator, denominator = regression.filtered_model(moved, learning, load)
        if vectors.lacks(abs(denominator[load.order]), _TINY):
            return [math.nan] * len(rows)
        shifted = load.physical(numerator, denominator)
        for i in range(len(values)):
            rows[i * count + j] = (shifted[i] - values[i]) / step
    return rows


# Rival explanations of an abrupt change, as directions in which θ becomes uncertain.

NOTHING = 0
DISTURBANCE = 1
LOAD = 2
BOTH = 3
ANEW = 4

DISTURBANCE_SHARE = 0.1
"""Deviation of a disturbance, of the input's scale: 30 V of 300 V."""


"""Divisor that counts as 0: 4,500 rounding errors of 1."""


@dataclass(slots=True)
class Anchor:
    """The last sample before the change.

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
    branch: Branch, kind: int, learning: EstimatorSettings, load: Load, anchor: Anchor
) -> None:
    """Open an estimate up for what a kind of change may have moved.

    Args:
        branch: P is overwritten.
        kind: NOTHING, DISTURBANCE, LOAD, BOTH, or ANEW for both and the state of the load.
        learning: Scales.
        load: Order and structure.
        anchor: The last sample before the change.
    """
    if kind == NOTHING:
        return
    order, size = regression.fitted_order(learning, load), len(branch.theta)
    last = order + len(load.input_powers) - 1
    gains = abs(vectors.total(branch.theta[order : last + 1]))
    if kind != LOAD and learning.bias:
        direction = vectors.unit(size, size - 1)
        _open(branch, direction, DISTURBANCE_SHARE * gains, learning, load, anchor)
    if kind != DISTURBANCE:
        _widen_load(branch, learning, load, anchor)
    if kind >= BOTH:
        direction = [0.0] * size
        direction[order : last + 1] = branch.theta[order : last + 1]
        _carry_offset(direction, branch.theta, 1.0, learning)
        _open(branch, direction, thresholds.PRIOR_SHARE, learning, load, anchor)
    share = min(1.0, anchor.gap_s / learning.tau_lambda_s)  # the moment of the change is in doubt
    spread = DISTURBANCE_SHARE * gains
    _widen_state(branch, share * share * spread * spread / anchor.power, learning, load)
    if kind == ANEW:  # a disk that lands at rest takes half the speed away
        _widen_state(
            branch, thresholds.PRIOR_SHARE * thresholds.PRIOR_SHARE / anchor.power, learning, load
        )


def _widen_load(branch: Branch, learning: EstimatorSettings, load: Load, anchor: Anchor) -> None:
    """Other dynamics with the same dc gain and the same offset of the input."""
    for i in range(regression.fitted_order(learning, load) + len(load.input_powers) - 1):
        direction = load_direction(branch.theta, i, learning, load)
        _open(branch, direction, thresholds.PRIOR_SHARE, learning, load, anchor)


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
    anchor: Anchor,
) -> None:
    """Widen P by a spread along a direction of θ and along what goes with it in γ, at least one."""
    size, count = len(direction), regression.initial_state_count(learning, load)
    first = regression.fitted_order(learning, load) + len(load.input_powers)
    plain, lowered = 0.0, 0.0
    for i in range(size):
        if not first <= i < first + count:
            plain += anchor.regressor[i] * direction[i]
            lowered += anchor.lowered[i] * direction[i]
    direction[first] = -plain
    if count > 1:
        direction[first + 1] = -lowered
    rls.widen(branch.upper, branch.diagonal, direction, spread * spread / anchor.power)


def _widen_state(branch: Branch, variance: float, learning: EstimatorSettings, load: Load) -> None:
    """Widen γ, what is left of the state at the change, by itself."""
    first = regression.fitted_order(learning, load) + len(load.input_powers)
    for i in range(regression.initial_state_count(learning, load)):
        direction = vectors.unit(len(branch.theta), first + i)
        rls.widen(branch.upper, branch.diagonal, direction, variance)
