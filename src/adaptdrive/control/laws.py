"""The contest of the two laws in each slow period: what it is given, and what follows from it."""

from __future__ import annotations

from adaptdrive.control.contest import (
    asked_output,
    forgive,
    lose,
    replay_law,
    replay_load,
    start_replay,
    wait,
    weigh,
)
from adaptdrive.control.ringing import is_ringing
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.slow_state import SlowSample, SlowState
from adaptdrive.control.vectors import copy_into, total

_WAIT = 2
"""Wait of a law that costs too much, in memories of the costs: until they are forgotten."""

_RING_WAIT = 0.5
"""Wait of a law that rings, likewise: a new estimate is there by then."""

_FORGIVEN = 10
"""Memories of the costs in force after which a loss is forgotten."""

_NOISE_COST = 0.1
"""Share of the variance of a sample's noise that is no difference between the laws."""

_SMALLEST_COST = 1.0e-7
"""Least cost that counts: an error of 0.03 % of the scale, 1 mV of a tachometer."""


def judge_laws(
    settings: ControllerSettings, state: SlowState, sample: SlowSample, reference: float
) -> None:
    """Weigh the law in force against the other one; the adaptive law waits when it loses.

    Args:
        settings: Scales and limits.
        state: Overwritten.
        sample: The present one.
        reference: r'[k].
    """
    contest, jacket = state.contest, settings.jacket
    trusted = state.supervisor.trusted
    asked = asked_output(contest, state.reference_filter.asked, state.trusted_b, reference)
    if trusted:
        replay_load(contest, state.trusted_a, state.trusted_b, state.inputs[0], sample.output)
    else:
        start_replay(contest, state.inputs, state.outputs, state.reference_filter)
    weigh(contest, sample.output, asked, 1.0 / jacket.loss_periods)
    push = total(state.adaptive_gains[len(state.inputs) :]) * (reference - contest.reference)
    contest.reference = reference
    rings = is_ringing(contest.ringing, state.inputs[0], push, jacket.noise_max)
    if state.adaptive and _costs_too_much(settings, state):
        lose(contest, _WAIT * jacket.loss_periods)
    elif state.adaptive and rings:
        lose(contest, int(_RING_WAIT * jacket.loss_periods))
    elif trusted:
        wait(contest)
        forgive(contest, _FORGIVEN * jacket.loss_periods)


def _costs_too_much(settings: ControllerSettings, state: SlowState) -> bool:
    """Check the adaptive law; what is far below the noise of a sample is no cost."""
    contest, scale = state.contest, settings.learning.output_scale
    floor = max(_SMALLEST_COST, _NOISE_COST * state.estimator.surprise.noise) * scale * scale
    return contest.adaptive_cost > settings.jacket.loss_max * contest.fixed_cost + floor


def replay_other_law(state: SlowState, sample: SlowSample, reference: float) -> None:
    """Let the law that is not in force decide; from the present state where the laws have changed.

    Args:
        state: Its contest is overwritten.
        sample: Limits of the input.
        reference: r'[k].
    """
    contest = state.contest
    if contest.adaptive != state.adaptive or not state.supervisor.trusted:
        contest.adaptive = state.adaptive
        start_replay(contest, state.inputs, state.outputs, state.reference_filter)
    elif state.adaptive:
        replay_law(contest, state.fixed_gains, reference, sample.low, sample.high, filtered=False)
    else:
        copy_into(contest.filter.asked, state.reference_filter.asked)
        copy_into(contest.filter.loop, state.reference_filter.loop)
        replay_law(contest, state.adaptive_gains, reference, sample.low, sample.high, filtered=True)
