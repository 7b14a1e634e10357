"""What one sample teaches the λ-method, and the estimate that is in force.

An alarm opens a comparison of hypotheses (`hypothesis_test`); the likeliest of them is the
estimate until one has won.

P shows how well the samples have determined a load that stays as it is. That load may have changed
since: at rest any dynamics predict the same output, an alarm takes samples to be explained, and
what explains it best for the moment may be wrong. While that is so, the standard deviations shown
are those of P opened up for another load (`hypotheses`): the load is known as it was, and the
loop keeps the gains that it has.

P takes the innovations for independent. Under a disturbance that moves each resembles the one
before, and the deviations shown are wider by what that costs.

An explanation may divide what has happened wrongly between load and disturbance. With u_0 the scale
of the input, a disturbance d that passes for dynamics moves a parameter by about d/u_0 of its
value. The deviations shown therefore include sqrt(Σ (d/u_0)²) of the values, over the disturbances
that were found lately: others of their size may not have been.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import (
    covariance,
    estimator,
    hypothesis_test,
    regression,
    rls,
    second_filters,
)
from adaptdrive.control.estimation.branch import Branch, copy_estimate, posterior_power
from adaptdrive.control.estimation.estimator import EstimatorState
from adaptdrive.control.estimation.hypothesis_test import is_change
from adaptdrive.control.estimation.rls import normalised, predict, widen
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# EstimatorSettings with explanations: what the λ-method does when a sample surprises it.

_LOUDER = thresholds.PRIOR_SAMPLES
"""Largest rise of σ² after an alarm that nothing explains, or that follows upon another: what was
known of it weighs as so many samples, of which one may have had all the noise."""


def learn_and_explain(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Learn a sample; one that completes the evidence for a change starts explanations of it."""
    if state.hypotheses.samples > 0:
        alarm = _explain(state, learning, load)
    else:
        alarm = is_change(state.detector, _squared(state.estimate, learning))
        if not alarm:
            estimator.take_in(state, learning, directional=True)
    if alarm:
        _split(state, learning, load)
    else:
        _mark(state)
        _challenge(state, learning, load)


def _squared(branch: Branch, learning: EstimatorSettings) -> float:
    """Return ε² ρ/(ρ + rᵀPr) of the last prediction of a branch."""
    return normalised(branch.excitation, branch.innovation, learning.forgetting)


def _explain(state: EstimatorState, learning: EstimatorSettings, load: Load) -> bool:
    """Compare the explanations of an alarm on one more sample; the likeliest is the estimate.

    The detector stays on: what surprises an explanation that is clearly ahead, or "nothing", is the
    next change, unless another explanation in the running expected it: the change that is being
    explained shows in it then.

    Returns:
        True when the next one has been noticed.
    """
    hypotheses = state.hypotheses
    hypothesis_test.follow(hypotheses, learning, load, state.sample)
    squared = _squared(hypothesis_test.likeliest(hypotheses), learning)
    alarm = is_change(state.detector, squared) and hypotheses.samples > thresholds.FEWEST
    alarm = alarm and (
        hypotheses.kind == covariance.NOTHING or hypothesis_test.is_clear(hypotheses)
    )
    alarm = alarm and not hypothesis_test.is_expected(hypotheses, learning)
    settled = not alarm and hypothesis_test.is_settled(hypotheses, learning, load)
    _publish(state, learning)
    if settled:
        _settle(state, learning, load)
    return alarm


def _split(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Start the explanations of an alarm.

    One alarm after the other, each before the last can be explained, is noise.
    """
    if state.periods - state.alarm_period < thresholds.WINDOW:
        state.detector.power *= _LOUDER
    state.alarm_period = state.periods
    if state.hypotheses.samples == 0:
        state.hypotheses.offset = _offset_share(state, learning, load)
    hypothesis_test.settle(state.hypotheses)
    hypothesis_test.keep_sample(state.hypotheses, state.sample, hypothesis_test.ROOM)
    begun = _challenge_anew(state, learning, load)
    hypothesis_test.split(state.hypotheses, learning, load, state.detector.power)
    _publish(state, learning)
    if not begun:
        _challenge(state, learning, load)


def _mark(state: EstimatorState) -> None:
    """Remember from where the next change is to be explained: from the last calm sample."""
    suspect = state.detector.sum > 0.0
    if not (
        suspect
        and hypothesis_test.keep_sample(state.hypotheses, state.sample, hypothesis_test.ROOM - 1)
    ):
        hypothesis_test.drop_anchor(state.hypotheses, state.estimate, state.sample)


def _offset_share(state: EstimatorState, learning: EstimatorSettings, load: Load) -> float:
    """Return the offset of the input over its scale; NaN without a bias."""
    return (
        regression.input_offset(state.estimate.theta, learning, load, state.charge)
        / learning.input_scale
    )


def _settle(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Keep the explanation that has won."""
    hypotheses = state.hypotheses
    if hypotheses.kind == covariance.DISTURBANCE:
        hypothesis_test.note_disturbance(hypotheses, _offset_share(state, learning, load))
    power = hypothesis_test.explained_power(hypotheses)
    if hypotheses.kind >= covariance.LOAD:
        state.detector.power = power
        second_filters.recount(state.second_filter, state.estimate)
    elif hypotheses.kind == covariance.NOTHING:
        state.detector.power = min(power, _LOUDER * state.detector.power)
    state.residual_power = state.detector.power * state.residual_weight
    hypothesis_test.settle(hypotheses)


def _publish(state: EstimatorState, learning: EstimatorSettings) -> None:
    """Make the likeliest explanation the estimate."""
    best = hypothesis_test.likeliest(state.hypotheses)
    copy_estimate(state.estimate, best)
    state.excitation = best.excitation
    state.innovation = best.innovation * learning.output_scale
    state.idle_periods = 0
    estimator.remember_residual(state, best, learning.forgetting)


def _challenge_anew(state: EstimatorState, learning: EstimatorSettings, load: Load) -> bool:
    """Start a second filter at an alarm, unless there is one that expected what surprised."""
    if not second_filters.is_surprised(state.second_filter, learning, load, state.sample):
        return False
    hypothesis_test.prepare(state.hypotheses, state.detector.power)
    second_filters.begin(state.second_filter, state.estimate, state.hypotheses, learning, load)
    return True


def _challenge(state: EstimatorState, learning: EstimatorSettings, load: Load) -> None:
    """Let the second filter predict the sample too; one that has won is the estimate."""
    second_filter, hypotheses, sample, own = (
        state.second_filter,
        state.hypotheses,
        state.sample,
        state.estimate,
    )
    if second_filter.samples == 0:
        return
    second_filters.follow(second_filter, learning, load, sample, own)
    regression.fill_initial_state(sample.regressor, learning, load, sample.time_s - own.origin_s)
    learning_load = hypotheses.samples > 0 and hypotheses.kind >= covariance.LOAD
    if not learning_load and second_filters.has_won(
        second_filter, own, hypotheses.loads, learning, load
    ):
        _take_over(state)


def _take_over(state: EstimatorState) -> None:
    """Make the second filter the estimate; the comparison that is under way ends."""
    second_filter, hypotheses = state.second_filter, state.hypotheses
    copy_estimate(state.estimate, second_filter.branch)
    power = posterior_power(second_filter.branch, second_filter.power, second_filter.judged)
    state.detector.power = power
    state.detector.sum = 0.0
    state.detector.alarms += 1
    state.residual_power = power * state.residual_weight
    hypotheses.kind = covariance.BOTH
    hypotheses.loads += 1.0
    hypotheses.samples = 0
    second_filter.samples = 0
    hypothesis_test.drop_anchor(hypotheses, state.estimate, state.sample)


# The estimate in force: the one whose bias rests, or the one whose bias walks (`second_filters`).


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
    innovation = state.innovation / learning.output_scale
    return rls.normalised(state.excitation, innovation, learning.forgetting)


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
    return covariance.root_of(in_force(state), residual_noise(state), learning, load, values)


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
        direction = covariance.load_direction(state.estimate.theta, i, learning, load)
        if abs(predict(direction, state.sample.regressor)) > _SHOWN * noise:
            state.unseen_periods = 0


def is_doubtful(state: EstimatorState) -> bool:
    """Return whether the load may be another than the estimate."""
    return state.unseen_periods > thresholds.FEWEST or is_contested(state)


def is_contested(state: EstimatorState) -> bool:
    """Return whether the latest samples speak for another load than the estimate."""
    if state.detector.sum > 0.0 or state.hypotheses.samples > 0:
        return True
    second_filter = state.second_filter
    if second_filter.samples == 0:
        return False
    return (
        second_filter.judged < thresholds.EARLIEST
        or second_filters.lead(second_filter, state.estimate) > 0.0
    )


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
            direction = covariance.load_direction(opened.theta, i, learning, load)
            widen(opened.upper, opened.diagonal, direction, spread * spread)
    own = covariance.deviations_of(opened, noise, learning, load, values)
    share = math.sqrt(state.hypotheses.moved)
    return [math.hypot(own[i], share * values[i]) for i in range(len(values))]
