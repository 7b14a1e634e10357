"""One slow period whose input the law has not decided: by hand, at a limit, out of reach."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowState, new_slow_state
from adaptdrive.control.watch import Fallback
from tests.closed_loop.bench import AT_REST, EXACT, MOTOR, PLAIN_LEARNING, REST_V

FIXED = replace(AT_REST, adaptive=False)


def at_rest(settings: object = EXACT) -> SlowState:
    return new_slow_state(settings, MOTOR, 3.0, REST_V)  # type: ignore[arg-type]


@pytest.mark.parametrize("followed", [True, False])
def test_an_error_counts_only_while_the_drive_follows(*, followed: bool) -> None:
    """The output stays although the set-point is 0.2 V away."""
    jacket = replace(EXACT.jacket, error_limit=0.1, response_distance=1.0)
    settings, state = replace(EXACT, jacket=jacket), at_rest()
    for _ in range(60):
        applied = REST_V if followed else REST_V + 1.0
        asked = replace(AT_REST, reference=3.2, followed=followed, applied=applied, high=1e9)
        slow_step(settings, MOTOR, state, asked)
    assert state.watch.fallback == (Fallback.ERROR if followed else Fallback.NONE)


def test_an_input_by_hand_takes_the_place_of_the_newest_in_the_history() -> None:
    state = at_rest()
    state.inputs[:] = [REST_V - number for number in range(len(state.inputs))]
    before = list(state.inputs)
    hand = replace(FIXED, manual=True, held=250.0)
    assert slow_step(EXACT, MOTOR, state, hand) == 250.0
    assert state.inputs == [250.0, 250.0, *before[1:-1]]


def test_by_hand_no_law_is_in_force_and_the_fixed_one_is_the_first_after_it() -> None:
    state = at_rest()
    state.adaptive, state.blend, state.handover_step = True, 1.0, 3.0
    slow_step(EXACT, MOTOR, state, replace(FIXED, manual=True, held=250.0))
    assert not state.adaptive
    assert state.blend == 0.0
    assert math.isnan(state.handover_step)


@pytest.mark.parametrize(
    ("held_V", "unresponsive"), [(200.0, True), (400.0, True), (210.0, False), (390.0, False)]
)
def test_an_input_by_hand_at_a_limit_shows_a_load_that_does_not_answer(
    held_V: float, *, unresponsive: bool
) -> None:
    """One within the limits is the operator's own, and judged by the operator."""
    jacket = replace(EXACT.jacket, response_periods=20, response_distance=0.05)
    settings, state = replace(EXACT, jacket=jacket), at_rest()
    for _ in range(400):
        slow_step(settings, MOTOR, state, replace(FIXED, manual=True, held=held_V))
    assert state.unresponsive is unresponsive


def test_a_rounding_error_is_known_in_the_scale_of_the_estimate() -> None:
    learning = replace(PLAIN_LEARNING, output_scale=4.0)
    settings = replace(EXACT, learning=learning)
    state = at_rest(settings)
    slow_step(settings, MOTOR, state, replace(FIXED, rounding=0.02))
    assert state.estimator.sample.rounding == 0.005


@pytest.mark.parametrize("scale", [0.5, 1.0, 4.0])
def test_the_error_of_the_nominal_load_is_none_where_it_rests_whatever_the_scale(
    scale: float,
) -> None:
    settings = replace(EXACT, learning=replace(PLAIN_LEARNING, output_scale=scale))
    state = at_rest(settings)
    slow_step(settings, MOTOR, state, FIXED)
    assert state.supervisor.fixed_power == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("outputs", "teaches"), [((3.125,), True), ((3.0625,), False), ((2.75, 2.75), False)]
)
def test_a_dead_band_begins_at_the_output_of_the_last_period(
    outputs: tuple[float, ...], *, teaches: bool
) -> None:
    settings = replace(EXACT, learning=replace(PLAIN_LEARNING, dead_band=0.125))
    state = at_rest(settings)
    for output in outputs:
        slow_step(settings, MOTOR, state, replace(FIXED, output=output))
    assert (state.estimator.idle_periods == 0) is teaches


def test_an_input_between_its_limits_is_at_none() -> None:
    for low, high in ((200.0, 400.0), (REST_V - 0.25, REST_V + 0.25)):
        state = at_rest()
        state.supervisor.own_power, state.supervisor.fixed_power = 0.0, 1e12
        slow_step(EXACT, MOTOR, state, replace(FIXED, low=low, high=high))
        assert state.cycles.side == 0
