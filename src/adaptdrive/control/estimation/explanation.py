"""Learning with explanations: what the λ-method does when a sample surprises it.

An alarm opens a comparison of rival explanations (`rivals`); the likeliest of them is the estimate
until one has won.
"""

from __future__ import annotations

from adaptdrive.control.estimation import rivals as riv
from adaptdrive.control.estimation import second_estimates
from adaptdrive.control.estimation.branch import Branch, copy_estimate, posterior_power
from adaptdrive.control.estimation.change_detector import is_surprising
from adaptdrive.control.estimation.estimator import EstimatorState, remember_residual, take_in
from adaptdrive.control.estimation.hypotheses import BOTH, DISTURBANCE, LOAD, NOTHING
from adaptdrive.control.estimation.regression import fill_initial_state, input_offset
from adaptdrive.control.estimation.rls import normalised
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.thresholds import FEWEST, PRIOR_SAMPLES, WINDOW

_LOUDER = PRIOR_SAMPLES
"""Largest rise of σ² after an alarm that nothing explains, or that follows upon another: what was
known of it weighs as so many samples, of which one may have had all the noise."""


def learn_and_explain(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Learn a sample; one that completes the evidence for a change starts explanations of it."""
    if state.rivals.samples > 0:
        alarm = _explain(state, learning, load)
    else:
        alarm = is_surprising(state.surprise, _squared(state.estimate, learning))
        if not alarm:
            take_in(state, learning, directional=True)
    if alarm:
        _split(state, learning, load)
    else:
        _mark(state)
        _challenge(state, learning, load)


def _squared(branch: Branch, learning: Learning) -> float:
    """Return ε² ρ/(ρ + rᵀPr) of the last prediction of a branch."""
    return normalised(branch.excitation, branch.innovation, learning.forgetting)


def _explain(state: EstimatorState, learning: Learning, load: Load) -> bool:
    """Compare the explanations of an alarm on one more sample; the likeliest is the estimate.

    The detector stays on: what surprises an explanation that is clearly ahead, or "nothing", is the
    next change, unless another explanation in the running expected it: the change that is being
    explained shows in it then.

    Returns:
        True when the next one has been noticed.
    """
    rivals = state.rivals
    riv.follow(rivals, learning, load, state.sample)
    squared = _squared(riv.likeliest(rivals), learning)
    alarm = is_surprising(state.surprise, squared) and rivals.samples > FEWEST
    alarm = alarm and (rivals.kind == NOTHING or riv.is_clear(rivals))
    alarm = alarm and not riv.is_expected(rivals, learning)
    settled = not alarm and riv.is_settled(rivals, learning, load)
    _publish(state, learning)
    if settled:
        _settle(state, learning, load)
    return alarm


def _split(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Start the explanations of an alarm.

    One alarm after the other, each before the last can be explained, is noise.
    """
    if state.periods - state.alarm_period < WINDOW:
        state.surprise.power *= _LOUDER
    state.alarm_period = state.periods
    if state.rivals.samples == 0:
        state.rivals.offset = _offset_share(state, learning, load)
    riv.settle(state.rivals)
    riv.keep_sample(state.rivals, state.sample, riv.ROOM)
    begun = _challenge_anew(state, learning, load)
    riv.split(state.rivals, learning, load, state.surprise.power)
    _publish(state, learning)
    if not begun:
        _challenge(state, learning, load)


def _mark(state: EstimatorState) -> None:
    """Remember from where the next change is to be explained: from the last calm sample."""
    suspect = state.surprise.sum > 0.0
    if not (suspect and riv.keep_sample(state.rivals, state.sample, riv.ROOM - 1)):
        riv.drop_anchor(state.rivals, state.estimate, state.sample)


def _offset_share(state: EstimatorState, learning: Learning, load: Load) -> float:
    """Return the offset of the input over its scale; NaN without a bias."""
    return input_offset(state.estimate.theta, learning, load, state.charge) / learning.input_scale


def _settle(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Keep the explanation that has won."""
    rivals = state.rivals
    if rivals.kind == DISTURBANCE:
        riv.note_disturbance(rivals, _offset_share(state, learning, load))
    power = riv.explained_power(rivals)
    if rivals.kind >= LOAD:
        state.surprise.power = power
        second_estimates.recount(state.challenger, state.estimate)
    elif rivals.kind == NOTHING:
        state.surprise.power = min(power, _LOUDER * state.surprise.power)
    state.residual_power = state.surprise.power * state.residual_weight
    riv.settle(rivals)


def _publish(state: EstimatorState, learning: Learning) -> None:
    """Make the likeliest explanation the estimate."""
    best = riv.likeliest(state.rivals)
    copy_estimate(state.estimate, best)
    state.excitation = best.excitation
    state.innovation = best.innovation * learning.output_scale
    state.idle_periods = 0
    remember_residual(state, best, learning.forgetting)


def _challenge_anew(state: EstimatorState, learning: Learning, load: Load) -> bool:
    """Start a challenger at an alarm, unless there is one that expected what surprised."""
    if not second_estimates.is_surprised(state.challenger, learning, load, state.sample):
        return False
    riv.prepare(state.rivals, state.surprise.power)
    second_estimates.begin(state.challenger, state.estimate, state.rivals, learning, load)
    return True


def _challenge(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Let the challenger predict the sample too; a challenger that has won is the estimate."""
    challenger, rivals, sample, own = state.challenger, state.rivals, state.sample, state.estimate
    if challenger.samples == 0:
        return
    second_estimates.follow(challenger, learning, load, sample, own)
    fill_initial_state(sample.regressor, learning, load, sample.time_s - own.origin_s)
    learning_load = rivals.samples > 0 and rivals.kind >= LOAD
    if not learning_load and second_estimates.has_won(
        challenger, own, rivals.loads, learning, load
    ):
        _take_over(state)


def _take_over(state: EstimatorState) -> None:
    """Make the challenger the estimate; the comparison that is under way ends."""
    challenger, rivals = state.challenger, state.rivals
    copy_estimate(state.estimate, challenger.branch)
    power = posterior_power(challenger.branch, challenger.power, challenger.judged)
    state.surprise.power = power
    state.surprise.sum = 0.0
    state.surprise.alarms += 1
    state.residual_power = power * state.residual_weight
    rivals.kind = BOTH
    rivals.loads += 1.0
    rivals.samples = 0
    challenger.samples = 0
    riv.drop_anchor(rivals, state.estimate, state.sample)
