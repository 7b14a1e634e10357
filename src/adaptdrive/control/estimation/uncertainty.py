"""What is known of the load: the estimate in force, and how sure it is.

P shows how well the samples have determined a load that stays as it is. That load may have changed
since: at rest any dynamics predict the same output, and an alarm takes samples to be explained.
While that is so, the standard deviations shown are those of P opened up for another load
(`change`): the load is known as it was, and the loop keeps the gains that it has.

P takes the innovations for independent. Under a disturbance that moves each resembles the one
before, and the deviations shown are wider by what that costs.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import bank, change, regression, rls
from adaptdrive.control.estimation.branch import Branch, copy_estimate, normalised
from adaptdrive.control.estimation.estimator import EstimatorState
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# The estimate in force: the one whose bias rests, or the one whose bias walks (`bank`).


def show(state: EstimatorState, learning: EstimatorSettings) -> None:
    """Publish innovation and excitation of the estimate in force."""
    if state.incremental.in_force:
        state.innovation = state.incremental.branch.innovation * learning.output_scale
        state.excitation = state.incremental.branch.excitation


def in_force(state: EstimatorState) -> Branch:
    """Return the estimate in force."""
    return state.incremental.branch if state.incremental.in_force else state.estimate


def own_residual(state: EstimatorState, learning: EstimatorSettings) -> float:
    """Squared innovation of the last sample, the estimate's own uncertainty taken out, scaled."""
    # as published: a sample that teaches nothing is predicted too, and not by each branch
    innovation = state.innovation / learning.output_scale
    return normalised(innovation, state.excitation, learning.forgetting)


def residual_noise(state: EstimatorState) -> float:
    """σ of the innovations, scaled; NaN before there are more of them than parameters."""
    power, weight = state.residual_power, state.residual_weight
    if state.incremental.in_force:
        power, weight = state.incremental.residual_power, state.incremental.residual_weight
    freedom = weight - len(state.estimate.theta)
    if freedom <= 0.0:
        return math.nan
    return math.sqrt(power / freedom)


def correlation_factor(state: EstimatorState) -> float:
    """Return the factor by which innovations that resemble their neighbours widen a deviation.

    n samples whose neighbours have the correlation φ carry the information of n (1 - φ)/(1 + φ)
    independent ones (G. V. Bayley and J. M. Hammersley, Suppl. J. Roy. Stat. Soc. 8, 1946,
    doi:10.2307/2983560), and no less than one. Noise has no correlation; the error that a moving
    disturbance leaves has one, and so has what came with an alarm, until it is forgotten: its
    explanation is not confirmed yet. A bias that walks follows a disturbance.

    Args:
        state: Sums over the innovations.
    """
    power, lag = state.residual_power, state.residual_lag
    if state.incremental.in_force or vectors.lacks(lag, 0.0):
        return 1.0
    if lag >= power:
        return math.sqrt(state.residual_weight)
    return math.sqrt(min((power + lag) / (power - lag), state.residual_weight))


def parameter_root(
    state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
) -> Vector:
    """L of the covariance L Lᵀ of the physical parameters, to first order.

    Args:
        state: θ and P.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    return root_of(in_force(state), residual_noise(state), learning, load, values)


# The covariance of the physical parameters of a load, from θ and P, to first order.

_TINY = 1e-12
"""Divisor that counts as 0: 4,500 rounding errors of 1."""


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
    size, root = len(values), root_of(branch, noise, learning, load, values)
    return [math.hypot(*root[i * size : (i + 1) * size]) for i in range(size)]


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


# Doubt: what the load may have become since the samples last showed it.

_SHOWN = 30.0
"""Movement of a sample, in σ, by an α that is larger by 1: 3 σ for a quarter of a second disk."""


def count_unseen(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Count the slow periods since a sample that would have shown another load.

    Args:
        state: r; the count is overwritten.
        learning: Scales.
        load: Order and structure.
    """
    state.unseen_periods += 1
    noise = math.sqrt(state.detector.power)
    for i in range(regression.fitted_order(learning, load)):
        direction = change.load_direction(state.estimate.theta, i, learning, load)
        if abs(rls.predict(direction, state.sample.regressor)) > _SHOWN * noise:
            state.unseen_periods = 0


def is_doubtful(state: EstimatorState) -> bool:
    """Return whether the load may be another than the estimate."""
    return state.unseen_periods > thresholds.FEWEST or is_contested(state)


def is_contested(state: EstimatorState) -> bool:
    """Return whether the latest samples speak for another load than the estimate."""
    return state.detector.sum > 0.0 or bank.is_contested(state.bank)


def inflated_deviations(
    state: EstimatorState, learning: EstimatorSettings, load: Load, values: Vector
) -> Vector:
    """Return the standard deviations to be shown: wider while the load may be another.

    Args:
        state: θ and P; its opened estimate is overwritten.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    opened, noise = state.opened, residual_noise(state)
    copy_estimate(opened, in_force(state))
    noise = math.sqrt(
        noise * noise
        + thresholds.NOISE_FLOOR
        + thresholds.MEMORY * state.sample.rounding * state.sample.rounding
    )
    noise *= correlation_factor(state)
    if learning.alert and noise > 0.0 and is_doubtful(state):
        spread = thresholds.UNKNOWN / noise
        for i in range(regression.fitted_order(learning, load)):
            direction = change.load_direction(opened.theta, i, learning, load)
            rls.widen(opened.upper, opened.diagonal, direction, spread * spread)
    return deviations_of(opened, noise, learning, load, values)
