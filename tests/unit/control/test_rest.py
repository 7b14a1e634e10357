"""Where a load rests, and what V_c can hold: dc gains of scipy, and laws of Ohm."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from adaptdrive.control.design.noise import Law
from adaptdrive.control.design.pole_placement import Plant
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging, Load
from adaptdrive.control.signals import Reach
from adaptdrive.control.supervision.setpoints import (
    distance_from_rest,
    estimated_reach,
    nominal_reach,
)
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.runtime.settings import can_hold
from tests.integration.closed_loop.bench import EXACT, MOTOR, REST_V, STAGE
from tests.unit.control.systems import motor_system, polynomials

BATH = bath_load(0.021, 200.0, 0.25, 1.0, 7.87)
CHARGED = battery_load(0.25, 0.3, 0.05, 60.0, Charging(0.25, 0.05, 0.25, 58.0, 1.0))
BIASED = replace(EXACT.learning, bias=True, alert=True)


def state_with(load: Load, offset: float = 0.0) -> SlowState:
    """A slow half whose estimate has an offset of the input."""
    state = SlowState(replace(EXACT, learning=BIASED), load, 3.0, REST_V)
    theta, first = state.estimator.estimate.theta, load.order
    gain = sum(theta[first : first + len(load.input_powers)])
    theta[-1] = gain * offset / BIASED.input_scale
    return state


def law_for(a: list[float], b: list[float]) -> Law:
    """A law of which only the model counts."""
    return Law(
        plant=Plant(a, b),
        asked=[],
        quiet_gains=[],
        quiet_noise=0.0,
        fast_loop=[],
        fast_gains=[],
        fast_noise=0.0,
    )


def trusts(state: SlowState, gain: float) -> None:
    """Let the last trusted model be a motor of another gain, as scipy holds its input."""
    held = polynomials(cont2discrete(motor_system(2, gain).state_space(), 1.0, "zoh"))
    state.law = law_for(*(part.tolist() for part in held))
    state.supervisor.trusted = True


@given(st.floats(-60.0, 60.0), st.floats(-1.0, 8.0))
def test_it_is_the_distance_to_the_nearest_of_all_places_of_rest(
    offset: float, output: float
) -> None:
    state = state_with(MOTOR, offset)
    state.sent = 250.0
    places = [0.011 * 250.0, 0.011 * (250.0 + offset)]
    expected = min(abs(output - place) for place in places)
    found = distance_from_rest(MOTOR, state, output)
    assert found == pytest.approx(expected, abs=1e-9)
    trusts(state, 0.02)
    state.supervisor.trusted = False
    assert distance_from_rest(MOTOR, state, output) == found
    state.supervisor.trusted = True
    places += [0.02 * 250.0, 0.02 * (250.0 + offset)]
    expected = min(abs(output - place) for place in places)
    assert distance_from_rest(MOTOR, state, output) == pytest.approx(expected, abs=1e-6)


def test_a_battery_takes_no_current_below_its_own_voltage() -> None:
    """200 V at a turns ratio of 0.25 are 50 V, and its EMF is 54 V."""
    state = state_with(CHARGED, -54.0 / 0.25)
    state.sent = 200.0
    assert distance_from_rest(CHARGED, state, 0.0) == pytest.approx(0.0, abs=1e-9)
    assert distance_from_rest(CHARGED, state, 0.5) == pytest.approx(0.5)
    state.sent = 220.0
    amperes = (55.0 - 54.0) / (0.3 + 0.05)
    assert distance_from_rest(CHARGED, state, 0.0) == pytest.approx(amperes)
    state.sent = 1.0
    assert distance_from_rest(CHARGED, state, 0.25 / 0.35) == pytest.approx(0.0)
    state.sent = -10.0
    assert distance_from_rest(CHARGED, state, 0.0) == 0.0


def test_the_nominal_reach_is_the_gain_times_both_limits() -> None:
    assert nominal_reach(MOTOR, STAGE) == Reach(2.2, 4.4)
    watts = [(0.25 * volts / (1.0 + 7.87)) ** 2 * 7.87 for volts in (200.0, 400.0)]
    found = nominal_reach(BATH, STAGE)
    assert found.low == pytest.approx(0.021 * watts[0], rel=5e-3)
    assert found.high == pytest.approx(0.021 * watts[1], rel=5e-3)
    unknown = nominal_reach(CHARGED, STAGE)
    assert math.isnan(unknown.low)
    assert math.isnan(unknown.high)
    assert not unknown.is_known


def test_the_estimated_reach_has_the_trusted_gain_and_the_offset() -> None:
    state = state_with(MOTOR, -40.0)
    trusts(state, 0.02)
    assert estimated_reach(MOTOR, STAGE, state) == Reach(3.2, 7.2)


def test_a_battery_reaches_from_nothing_to_what_its_resistance_lets_through() -> None:
    state = state_with(CHARGED, -54.0 / 0.25)
    gain = 0.25 / 0.35
    state.law = law_for([1.0, 0.0], [0.0, gain])
    found = estimated_reach(CHARGED, STAGE, state)
    assert found.low == 0.0
    flat = replace(STAGE, boost_reference_max_V=200.5)
    assert estimated_reach(CHARGED, flat, state).high == 0.0
    assert found.high == pytest.approx((100.0 - 54.0) / 0.35, rel=5e-3)


@given(st.floats(-5.0, 5.0), st.floats(0.0, 5.0), st.floats(-20.0, 20.0))
def test_the_nearest_within_reach_is_held_and_moves_only_what_is_not(
    low: float, width: float, value: float
) -> None:
    reach = Reach(low, low + width)
    nearest = reach.nearest(value)
    assert reach.is_known
    assert can_hold(reach, nearest)
    assert can_hold(reach, value) == (nearest == value)
    assert can_hold(reach, low)
    assert can_hold(reach, low + width)
    assert abs(nearest - value) <= min(abs(low - value), abs(low + width - value))
