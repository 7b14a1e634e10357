"""Learning with explanations: what the λ-method does when a sample surprises it.

An alarm opens a comparison of rival explanations (`rivals`); the likeliest of them is the estimate
until one has won.
"""

from __future__ import annotations

from adaptdrive.control import challenger as chal
from adaptdrive.control import rivals as riv
from adaptdrive.control.estimator import (
    EstimatorState,
    hold_estimate,
    remember_residual,
    take_in,
)
from adaptdrive.control.evidence import FEWEST, WINDOW
from adaptdrive.control.hypotheses import BOTH, DISTURBANCE, LOAD, NOTHING, copy_estimate
from adaptdrive.control.load import Load
from adaptdrive.control.regression import fill_initial_state, input_offset
from adaptdrive.control.rls import normalised
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import is_surprising

_LOUDER = 4.0
"""Largest rise of σ² after an alarm that nothing explains, or that follows upon another."""


def learn_and_explain(
    state: EstimatorState, learning: Learning, load: Load, target: float, innovation: float
) -> None:
    """Learn a sample; one that completes the evidence for a change starts explanations of it."""
    if state.rivals.samples > 0:
        alarm = _explain(state, learning, load, target)
    else:
        squared = normalised(state.excitation, innovation, learning.forgetting)
        alarm = is_surprising(state.surprise, squared)
        if not alarm:
            take_in(state, learning, target, innovation, directional=True)
            hold_estimate(state)
    if alarm:
        _split(state, learning, load, target)
    else:
        _mark(state, target)
        _challenge(state, learning, load, target)


def _explain(state: EstimatorState, learning: Learning, load: Load, target: float) -> bool:
    """Compare the explanations of an alarm on one more sample; the likeliest is the estimate.

    The detector goes on: what surprises an explanation that is clearly ahead, or "nothing", is the
    next change, unless another explanation in the running expected it: the change that is being
    explained shows in it then.

    Returns:
        True when the next one has been noticed.
    """
    rivals = state.rivals
    riv.follow(rivals, learning, load, state.regressor, target, state.elapsed_s)
    best = riv.branch_of(rivals, rivals.kind)
    squared = normalised(best.excitation, best.innovation, learning.forgetting)
    alarm = is_surprising(state.surprise, squared) and rivals.samples > FEWEST
    alarm = alarm and (rivals.kind == NOTHING or riv.is_clear(rivals))
    alarm = alarm and not riv.is_expected(rivals, learning)
    settled = not alarm and riv.is_settled(rivals, learning, load)
    _publish(state, learning)
    if settled:
        _settle(state, learning, load)
    return alarm


def _split(state: EstimatorState, learning: Learning, load: Load, target: float) -> None:
    """Start the explanations of an alarm.

    One alarm after the other, each before the last can be explained, is noise of its own.
    """
    if state.periods - state.alarm_period < WINDOW:
        state.surprise.power *= _LOUDER
    state.alarm_period = state.periods
    if state.rivals.samples == 0:
        state.rivals.offset = _offset_share(state, learning, load)
    riv.settle(state.rivals)
    riv.keep_sample(state.rivals, state.regressor, target, state.elapsed_s, riv.ROOM)
    begun = _challenge_anew(state, learning, load, target)
    riv.split(state.rivals, learning, load, state.surprise.power)
    _publish(state, learning)
    if not begun:
        _challenge(state, learning, load, target)


def _mark(state: EstimatorState, target: float) -> None:
    """Remember from where the next change is to be explained: from the last calm sample."""
    rivals, time_s = state.rivals, state.elapsed_s
    suspect = state.surprise.sum > 0.0
    if suspect and riv.keep_sample(rivals, state.regressor, target, time_s, riv.ROOM - 1):
        return
    riv.drop_anchor(state.rivals, state.regressor, state.elapsed_s)


def _offset_share(state: EstimatorState, learning: Learning, load: Load) -> float:
    """Return the offset of the input over its scale; NaN without a bias."""
    return input_offset(state.theta, learning, load, state.charge) / learning.input_scale


def _settle(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Keep the explanation that has won."""
    rivals = state.rivals
    if rivals.kind == DISTURBANCE:
        riv.note_disturbance(rivals, _offset_share(state, learning, load))
    power = riv.posterior_power(rivals)
    if rivals.kind >= LOAD:
        state.surprise.power = power
        chal.recount(state.challenger)
    elif rivals.kind == NOTHING:
        state.surprise.power = min(power, _LOUDER * state.surprise.power)
    state.residual_power = state.surprise.power * state.residual_weight
    riv.settle(rivals)


def _publish(state: EstimatorState, learning: Learning) -> None:
    """Make the likeliest explanation the estimate."""
    best = riv.branch_of(state.rivals, state.rivals.kind)
    copy_estimate(state, best)
    state.excitation = best.excitation
    state.innovation = best.innovation * learning.output_scale
    state.idle_periods = 0
    copy_estimate(state.rivals.now, best)
    remember_residual(state, learning, best.excitation, best.innovation)


def _challenge_anew(state: EstimatorState, learning: Learning, load: Load, target: float) -> bool:
    """Start a challenger at an alarm, unless there is one that expected what surprised."""
    challenger, rivals = state.challenger, state.rivals
    regressor, time_s = state.regressor, state.elapsed_s
    if not chal.is_surprised(challenger, learning, load, regressor, target, time_s):
        return False
    riv.prepare(rivals, state.surprise.power)
    chal.begin(challenger, rivals, learning, load)
    return True


def _challenge(state: EstimatorState, learning: Learning, load: Load, target: float) -> None:
    """Let the challenger predict the sample too; a challenger that has won is the estimate."""
    challenger = state.challenger
    if challenger.samples == 0:
        return
    innovation = state.innovation / learning.output_scale
    regressor, time_s = state.regressor, state.elapsed_s
    chal.follow(challenger, learning, load, regressor, target, time_s, state.excitation, innovation)
    fill_initial_state(regressor, learning, load, time_s - state.origin_s)
    learning_load = state.rivals.samples > 0 and state.rivals.kind >= LOAD
    if not learning_load and chal.has_won(challenger, state.rivals.loads, learning, load):
        _take_over(state)


def _take_over(state: EstimatorState) -> None:
    """Make the challenger the estimate; the comparison that is under way ends."""
    challenger, rivals = state.challenger, state.rivals
    copy_estimate(state, challenger.branch)
    power = chal.posterior_power(challenger)
    state.surprise.power = power
    state.surprise.sum = 0.0
    state.surprise.alarms += 1
    state.residual_power = power * state.residual_weight
    rivals.kind = BOTH
    rivals.loads += 1.0
    rivals.samples = 0
    challenger.samples = 0
    hold_estimate(state)
    riv.drop_anchor(rivals, state.regressor, state.elapsed_s)
