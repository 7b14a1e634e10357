"""The on-line estimator: recursive least squares with a gate, a bound of P and an alarm.

What is learnt, and from what, is in `regression`; the update itself in `rls`; what counts as an
abrupt change in `surprise`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rls
from adaptdrive.control.load import Load
from adaptdrive.control.regression import (
    dc_gain,
    filtered_model,
    fitted_order,
    initial_state_count,
    nominal_theta,
    parameter_count,
    theta_of,
)
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import Surprise, is_surprising
from adaptdrive.control.vectors import Vector, copy_into

_TINY = 1e-12
_PRIOR_SHARE = 0.2
_GAIN_DOUBT = 0.5


@dataclass(slots=True)
class EstimatorState:
    """State of the estimator.

    Attributes:
        theta: θ in scaled units.
        upper: U of P = U D Uᵀ.
        diagonal: D.
        regressor: r of the last sample, scaled.
        residual_power: Forgetting sum of squared normalised innovations.
        residual_weight: Forgetting count of them.
        innovation: ε of the last sample, in the unit of the output.
        excitation: rᵀPr of the last sample.
        periods: Slow periods since start.
        idle_periods: Slow periods since the last sample that taught something.
        elapsed_s: Time since start.
        surprise: Detector of abrupt changes.
    """

    theta: Vector
    upper: Vector
    diagonal: Vector
    regressor: Vector
    surprise: Surprise
    residual_power: float = 0.0
    residual_weight: float = 0.0
    innovation: float = math.nan
    excitation: float = 0.0
    periods: int = 0
    idle_periods: int = 0
    elapsed_s: float = 0.0


def new_estimator(learning: Learning, load: Load, taps: int) -> EstimatorState:
    """Return an estimator without data, which starts from zero or from the nominal model."""
    count = parameter_count(learning, load, taps)
    state = EstimatorState(
        [0.0] * count, [0.0] * (count * count), [0.0] * count, [0.0] * count, Surprise()
    )
    rls.reset(state.theta, state.upper, state.diagonal, learning.initial_covariance)
    if learning.start_at_nominal and learning.filtered:
        copy_into(state.theta, nominal_theta(learning, load, taps))
    return state


def start_from(state: EstimatorState, learning: Learning, load: Load, values: Vector) -> None:
    """Start from a load that an earlier run has learnt, moderately sure of it.

    Sure enough to be confirmed without much excitation, and doubtful enough to be corrected within
    seconds by data that say otherwise; nothing is known of the bias.

    Args:
        state: A new estimator of the λ-method, overwritten.
        learning: Scales.
        load: The load.
        values: Its physical parameters.
    """
    numerator, denominator = load.realise(values)
    theta = theta_of(learning, load, numerator, denominator)
    copy_into(state.theta, theta)
    for i in range(len(theta)):
        state.diagonal[i] = _PRIOR_SHARE * learning.initial_covariance


def _open_up(state: EstimatorState, learning: Learning, load: Load) -> None:
    """After an abrupt change: doubt the dynamics and the bias, and the gain only the second time.

    A load changes its inertia or its volume far more often than its gain, and a constant
    disturbance comes and goes. So the first alarm widens P along the directions that keep the dc
    gain, Σβ / (1 + Σα), and along the bias; an alarm soon after it doubts the gain, too, by half.
    """
    if not learning.filtered:
        rls.open_up(state.upper, state.diagonal, learning.initial_covariance)
        return
    count, order = len(state.theta), fitted_order(learning, load)
    last = order + len(load.input_powers) - 1
    if state.surprise.repeated:
        direction = [0.0] * count
        direction[last] = _GAIN_DOUBT * state.theta[last]
        rls.widen(state.upper, state.diagonal, direction, 1.0)
    past = last + initial_state_count(learning, load)  # what is past has not changed
    for i in range(count):
        if last <= i <= past:
            continue
        direction = [0.0] * count
        direction[i] = 1.0
        if i < order:
            direction[last] = dc_gain(state.theta, learning, load)
        elif i < last:
            direction[last] = -1.0
        rls.widen(state.upper, state.diagonal, direction, learning.initial_covariance)


def learn(
    state: EstimatorState, learning: Learning, load: Load, output: float, usable: bool
) -> None:
    """Take in one slow sample whose regressor has been filled in.

    Args:
        state: Overwritten.
        learning: Forgetting and gates.
        load: What an abrupt change leaves as it was.
        output: y[k], or what `learning_target` makes of it.
        usable: False for a sample that must not teach: its innovation is still computed.
    """
    target = output / learning.output_scale
    state.periods += 1
    state.excitation = rls.excitation(state.upper, state.diagonal, state.regressor)
    innovation = target - rls.predict(state.theta, state.regressor)
    state.innovation = innovation * learning.output_scale
    if not (math.isfinite(state.excitation) and math.isfinite(innovation)):
        return
    state.idle_periods += 1
    if not usable or state.periods <= learning.settle_periods:
        return
    squared = _normalised(state.excitation, innovation, learning.forgetting)
    if learning.alert and is_surprising(state.surprise, squared):
        _open_up(state, learning, load)
        state.excitation = rls.excitation(state.upper, state.diagonal, state.regressor)
        state.residual_power = state.surprise.power * state.residual_weight
    if not state.excitation > learning.gate * (1.0 - learning.forgetting):
        return
    state.idle_periods = 0
    rls.update(
        state.theta, state.upper, state.diagonal, state.regressor, target, learning.forgetting
    )
    if learning.covariance_max > 0.0:
        information = (1.0 - learning.forgetting) / learning.covariance_max
        rls.bound(state.upper, state.diagonal, information)
    normalised = _normalised(state.excitation, innovation, learning.forgetting)
    state.residual_power = learning.forgetting * state.residual_power + normalised
    state.residual_weight = learning.forgetting * state.residual_weight + 1.0


def _normalised(excitation: float, innovation: float, forgetting: float) -> float:
    """ε² without the share that the uncertainty of θ has in it."""
    return innovation * innovation * forgetting / (forgetting + excitation)


def own_residual(state: EstimatorState, learning: Learning) -> float:
    """Squared innovation of the last sample, the estimate's own uncertainty taken out, scaled."""
    innovation = state.innovation / learning.output_scale
    return _normalised(state.excitation, innovation, learning.forgetting)


def residual_noise(state: EstimatorState) -> float:
    """σ of the innovations, scaled; NaN before there are more of them than parameters."""
    freedom = state.residual_weight - len(state.theta)
    if freedom <= 0.0:
        return math.nan
    return math.sqrt(state.residual_power / freedom)


def parameter_deviations(
    state: EstimatorState, learning: Learning, load: Load, values: Vector
) -> Vector:
    """Standard deviations of the physical parameters, to first order.

    Args:
        state: θ and P.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    noise = residual_noise(state)
    count = len(state.theta)
    jacobian = [0.0] * (len(values) * count)
    for j in range(count):
        step = 1e-6 * max(1.0, abs(state.theta[j]))
        moved = list(state.theta)
        moved[j] += step
        numerator, denominator = filtered_model(moved, learning, load)
        if not abs(denominator[load.order]) > _TINY:
            return [math.nan] * len(values)
        shifted = load.physical(numerator, denominator)
        for i in range(len(values)):
            jacobian[i * count + j] = (shifted[i] - values[i]) / step
    deviations = [0.0] * len(values)
    for i in range(len(values)):
        row = jacobian[i * count : (i + 1) * count]
        deviations[i] = rls.standard_deviation(row, state.upper, state.diagonal, noise)
    return deviations
