"""What follows from the contest of the laws: the adaptive law waits, and comes back."""

from __future__ import annotations

from dataclasses import replace

import pytest

from adaptdrive.control.design import asked_loop, compensator_gains, discrete_model
from adaptdrive.control.laws import judge_laws, replay_other_law
from adaptdrive.control.reasons import reason
from adaptdrive.control.signals import Mode
from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowSample, SlowState, new_slow_state
from adaptdrive.control.supervisor import Verdict
from adaptdrive.control.vectors import copy_into
from tests.closed_loop.bench import EXACT, MOTOR

MEMORY = 20
SETTINGS = replace(
    EXACT, jacket=replace(EXACT.jacket, loss_max=1.1, loss_periods=MEMORY, noise_max=8.0)
)
A, B = discrete_model(EXACT, MOTOR, list(MOTOR.numerator), list(MOTOR.denominator), 1.0)
REST_V = 3.0 / 0.011


def trusted(*, adaptive: bool) -> SlowState:
    """Both laws are the same, and the estimate is right."""
    state = new_slow_state(SETTINGS, MOTOR, 3.0, REST_V)
    copy_into(state.trusted_a, A)
    copy_into(state.trusted_b, B)
    gains = compensator_gains(A, B, MOTOR.order, 0.7)
    copy_into(state.fixed_gains, gains)
    copy_into(state.adaptive_gains, gains)
    copy_into(state.reference_filter.asked, asked_loop(B, MOTOR.order, 0.7))
    state.supervisor.trusted, state.supervisor.verdict = True, Verdict.TRUSTED
    state.adaptive = state.contest.adaptive = adaptive
    return state


def sample(output: float = 3.0) -> SlowSample:
    return SlowSample(
        period_s=1.0,
        output=output,
        output_filtered=[output, output],
        input_filtered=[REST_V, REST_V, REST_V],
        applied=REST_V,
        followed=True,
        held_share=0.0,
        reference=3.0,
        adaptive=True,
        pole=0.7,
        low=200.0,
        high=400.0,
    )


def judge(state: SlowState, output: float) -> None:
    judge_laws(SETTINGS, state, sample(output), 3.0)


def test_laws_that_do_the_same_cost_the_same() -> None:
    state = trusted(adaptive=True)
    for _ in range(100):
        judge(state, 3.01)
        replay_other_law(state, sample(3.01), 3.0)
        state.inputs = list(state.contest.inputs)
    assert state.contest.adaptive_cost == pytest.approx(state.contest.fixed_cost)
    assert state.contest.waiting_periods == 0


def test_an_adaptive_law_that_costs_more_waits_and_says_so() -> None:
    state = trusted(adaptive=True)
    state.contest.adaptive_cost, state.contest.fixed_cost = 0.012, 0.010
    judge(state, 3.0)
    assert state.contest.waiting_periods == 2 * MEMORY
    assert reason(state, SETTINGS.jacket, MOTOR, Mode.ADAPTIVE).startswith("waits: costs more")
    assert reason(state, SETTINGS.jacket, MOTOR, Mode.FIXED) == "mode fixed asked for"


@pytest.mark.parametrize("costs", [(0.0109, 0.010), (1e-9, 0.0)])
def test_a_little_more_is_no_loss(costs: tuple[float, float]) -> None:
    state = trusted(adaptive=True)
    state.contest.adaptive_cost, state.contest.fixed_cost = costs
    judge(state, 3.0)
    assert state.contest.waiting_periods == 0


def test_an_adaptive_law_that_rings_waits() -> None:
    state = trusted(adaptive=True)
    for k in range(4):
        state.inputs[0] = REST_V + 60.0 * (-1.0) ** k
        state.contest.inputs[0] = state.inputs[0]
        judge(state, 3.0)
    assert state.contest.waiting_periods == MEMORY // 2


def test_while_it_waits_the_fixed_law_is_in_force_and_then_no_longer() -> None:
    state = trusted(adaptive=False)
    state.contest.waiting_periods = 3
    state.contest.fixed_cost = 1.0
    in_force = []
    settings = replace(SETTINGS, jacket=replace(SETTINGS.jacket, patience_periods=1000))
    for _ in range(5):
        slow_step(settings, MOTOR, state, sample())
        in_force.append(state.adaptive)
    assert in_force == [False, False, True, True, True]


def test_without_the_rule_nothing_is_weighed() -> None:
    state = trusted(adaptive=False)
    state.contest.fixed_cost = 1.0
    off = replace(SETTINGS, jacket=replace(SETTINGS.jacket, loss_max=0.0, patience_periods=1000))
    slow_step(off, MOTOR, state, sample())
    assert state.contest.fixed_cost == 1.0
    assert state.adaptive
