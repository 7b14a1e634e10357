"""The on-line estimator: recursive least squares with a gate, a bound of P and an alarm.

What is learnt, and from what, is in `regression`; the update itself in `rls`; what counts as an
abrupt change in `surprise`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rivals as riv
from adaptdrive.control import rls
from adaptdrive.control.hypotheses import LOAD, NOTHING
from adaptdrive.control.load import Load
from adaptdrive.control.regression import (
    filtered_model,
    fitted_order,
    initial_state_count,
    nominal_theta,
    parameter_count,
    theta_of,
)
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import Surprise, is_surprising, watch_noise
from adaptdrive.control.vectors import Vector, copy_into

_TINY = 1e-12
_PRIOR_VARIANCE = 2.0e3
"""Variance of a prior over σ²: a few samples confirm it, some seconds of others correct it."""

SETTLED_SAMPLES = 5
"""Samples of a comparison before another alarm counts: about as many as there are parameters."""

_LOUDER = 4.0
"""Largest rise of σ² after an alarm that nothing explains, or that follows upon another."""

_KNOWN = 1.0e-9
"""Variance of an initial state that need not be estimated, over p0."""


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
        origin_s: Since when the functions of the initial state are counted.
        surprise: Detector of abrupt changes.
        alarm_period: Slow period of the last alarm.
        lost_periods: Slow periods in a row in which no load can have such an estimate.
        rivals: Explanations of an alarm.
    """

    theta: Vector
    upper: Vector
    diagonal: Vector
    regressor: Vector
    surprise: Surprise
    rivals: riv.Rivals
    residual_power: float = 0.0
    residual_weight: float = 0.0
    innovation: float = math.nan
    excitation: float = 0.0
    periods: int = 0
    idle_periods: int = 0
    elapsed_s: float = 0.0
    origin_s: float = 0.0
    alarm_period: int = -riv.WINDOW
    lost_periods: int = 0


def new_estimator(learning: Learning, load: Load, taps: int) -> EstimatorState:
    """Return an estimator without data, which starts from zero or from the nominal model."""
    count = parameter_count(learning, load, taps)
    state = EstimatorState(
        [0.0] * count,
        [0.0] * (count * count),
        [0.0] * count,
        [0.0] * count,
        Surprise(),
        riv.new_rivals(count),
    )
    rls.reset(state.theta, state.upper, state.diagonal, learning.initial_covariance)
    if learning.filtered and not learning.initial_state:
        _know_initial_state(state, learning, load)
    if learning.start_at_nominal and learning.filtered:
        copy_into(state.theta, nominal_theta(learning, load, taps))
    return state


def begin_anew(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Start from the nominal model again: an estimate that no load can have has lost its way.

    It learnt a disturbance as dynamics before σ² was known, and what surprises it is explained by
    other disturbances ever since.
    """
    theta = theta_of(learning, load, list(load.numerator), list(load.denominator))
    rls.reset(state.theta, state.upper, state.diagonal, learning.initial_covariance)
    copy_into(state.theta, theta)
    state.origin_s = state.elapsed_s
    state.lost_periods = 0
    state.surprise.sum = 0.0
    state.rivals.samples = 0
    _hold(state)
    riv.drop_anchor(state.rivals, state.regressor, state.elapsed_s)


def _know_initial_state(state: EstimatorState, learning: Learning, load: Load) -> None:
    """At rest at the start: γ is 0, until something changes."""
    first = fitted_order(learning, load) + len(load.input_powers)
    for i in range(initial_state_count(learning, load)):
        state.diagonal[first + i] = _KNOWN * learning.initial_covariance


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
        state.diagonal[i] = _PRIOR_VARIANCE


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
    if not (math.isfinite(state.excitation) and math.isfinite(innovation * innovation)):
        return
    state.idle_periods += 1
    riv.forget_loads(state.rivals)
    if not usable or state.periods <= learning.settle_periods:
        return
    watch_noise(state.surprise, innovation)
    if learning.alert and learning.filtered:
        _learn_and_explain(state, learning, load, target, innovation)
        return
    if learning.alert:
        _open_up(state, learning, innovation)
    _take_in(state, learning, target, innovation)


def _learn_and_explain(
    state: EstimatorState, learning: Learning, load: Load, target: float, innovation: float
) -> None:
    """Learn a sample; one that completes the evidence for a change starts explanations of it."""
    if state.rivals.samples > 0:
        alarm = _explain(state, learning, load, target)
    else:
        squared = _normalised(state.excitation, innovation, learning.forgetting)
        alarm = is_surprising(state.surprise, squared)
        if not alarm:
            _take_in(state, learning, target, innovation)
            _hold(state)
    if alarm:
        _split(state, learning, load, target)
    else:
        _mark(state, target)


def _take_in(state: EstimatorState, learning: Learning, target: float, innovation: float) -> None:
    """Update θ and P, if the sample can teach anything."""
    if not state.excitation > learning.gate * (1.0 - learning.forgetting):
        return
    state.idle_periods = 0
    theta, upper, diagonal, regressor = state.theta, state.upper, state.diagonal, state.regressor
    if learning.alert and learning.filtered:
        rls.update_along(theta, upper, diagonal, regressor, target, learning.forgetting)
    else:
        rls.update(theta, upper, diagonal, regressor, target, learning.forgetting)
    if learning.covariance_max > 0.0:
        information = (1.0 - learning.forgetting) / learning.covariance_max
        rls.bound(state.upper, state.diagonal, information)
    _remember_residual(state, learning, state.excitation, innovation)


def _open_up(state: EstimatorState, learning: Learning, innovation: float) -> None:
    """After an abrupt change of a load that is learnt directly: forget how sure θ is."""
    squared = _normalised(state.excitation, innovation, learning.forgetting)
    if not is_surprising(state.surprise, squared):
        return
    rls.open_up(state.upper, state.diagonal, learning.initial_covariance)
    state.excitation = rls.excitation(state.upper, state.diagonal, state.regressor)
    state.residual_power = state.surprise.power * state.residual_weight


def _explain(state: EstimatorState, learning: Learning, load: Load, target: float) -> bool:
    """Compare the explanations of an alarm on one more sample; the likeliest is the estimate.

    The detector goes on: what surprises an explanation that is clearly ahead, or "nothing", is the
    next change.

    Returns:
        True when the next one has been noticed.
    """
    rivals = state.rivals
    riv.follow(rivals, learning, load, state.regressor, target, state.elapsed_s)
    best = riv.branch_of(rivals, rivals.kind)
    squared = _normalised(best.excitation, best.innovation, learning.forgetting)
    alarm = is_surprising(state.surprise, squared) and rivals.samples > SETTLED_SAMPLES
    alarm = alarm and (rivals.kind == NOTHING or riv.is_clear(rivals))
    settled = not alarm and riv.is_settled(rivals, learning, load)
    _publish(state, learning)
    if settled:
        _settle(state)
    return alarm


def _split(state: EstimatorState, learning: Learning, load: Load, target: float) -> None:
    """Start the explanations of an alarm.

    One alarm after the other, each before the last can be explained, is noise of its own.
    """
    if state.periods - state.alarm_period < riv.WINDOW:
        state.surprise.power *= _LOUDER
    state.alarm_period = state.periods
    riv.settle(state.rivals)
    riv.keep_sample(state.rivals, state.regressor, target, state.elapsed_s, riv.ROOM)
    riv.split(state.rivals, learning, load, state.surprise.power)
    _publish(state, learning)


def _mark(state: EstimatorState, target: float) -> None:
    """Remember from where the next change is to be explained: from the last calm sample."""
    rivals, time_s = state.rivals, state.elapsed_s
    suspect = state.surprise.sum > 0.0
    if suspect and riv.keep_sample(rivals, state.regressor, target, time_s, riv.ROOM - 1):
        return
    riv.drop_anchor(state.rivals, state.regressor, state.elapsed_s)


def _settle(state: EstimatorState) -> None:
    """Keep the explanation that has won."""
    rivals = state.rivals
    power = riv.posterior_power(rivals)
    if rivals.kind >= LOAD:
        state.surprise.power = power
    elif rivals.kind == NOTHING:
        state.surprise.power = min(power, _LOUDER * state.surprise.power)
    state.residual_power = state.surprise.power * state.residual_weight
    riv.settle(rivals)


def _hold(state: EstimatorState) -> None:
    """Let the explanations of the next alarm start from the estimate of now."""
    now = state.rivals.now
    copy_into(now.theta, state.theta)
    copy_into(now.upper, state.upper)
    copy_into(now.diagonal, state.diagonal)
    now.origin_s = state.origin_s


def _publish(state: EstimatorState, learning: Learning) -> None:
    """Make the likeliest explanation the estimate."""
    best = riv.branch_of(state.rivals, state.rivals.kind)
    copy_into(state.theta, best.theta)
    copy_into(state.upper, best.upper)
    copy_into(state.diagonal, best.diagonal)
    state.origin_s = best.origin_s
    state.excitation = best.excitation
    state.innovation = best.innovation * learning.output_scale
    state.idle_periods = 0
    riv.copy_estimate(state.rivals.now, best)
    _remember_residual(state, learning, best.excitation, best.innovation)


def _remember_residual(
    state: EstimatorState, learning: Learning, excitation: float, innovation: float
) -> None:
    normalised = _normalised(excitation, innovation, learning.forgetting)
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
