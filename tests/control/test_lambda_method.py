"""The λ-method's own part: its regressor, its start, and its bound on P."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adaptdrive.control import estimator as est
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.load import Load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.settings import Learning
from adaptdrive.control.slow_state import SlowState, new_slow_state
from tests.closed_loop.bench import AT_REST, EXACT, MOTOR, SCALED_LEARNING
from tests.control.systems import Array

BATTERY = battery_load(0.25, 1.2, 0.4, 30.0)
SAMPLE = replace(
    AT_REST,
    output=3.3,
    output_filtered=[3.2, 3.1],
    input_filtered=[300.0, 290.0, 285.0],
)
TAU_s = SCALED_LEARNING.tau_lambda_s


def filled(learning: Learning, load: Load) -> SlowState:
    """A state 60 s after its start, 20 s after its origin, whose r has been filled in."""
    state = new_slow_state(replace(EXACT, learning=learning), load, 3.0, 280.0)
    estimator = state.estimator
    estimator.sample.time_s, estimator.estimate.origin_s, estimator.charge = 60.0, 40.0, 0.7
    learning.method.fill_regressor(state, learning, load, SAMPLE)
    return state


def covariance(state: est.EstimatorState) -> Array:
    count = len(state.estimate.theta)
    flat = ud.covariance(state.estimate.upper, state.estimate.diagonal)
    return np.reshape(np.array(flat), (count, count))


def test_the_regressor_of_a_motor_is_equation_29_and_the_initial_state_since_the_origin() -> None:
    learning = replace(SCALED_LEARNING, initial_state=True, bias=True)
    found = filled(learning, MOTOR).estimator.sample.regressor
    ratio = 20.0 / TAU_s
    expected = [-3.2 / 3.0, -3.1 / 3.0, 285.0 / 280.0]
    expected += [math.exp(-ratio), ratio * math.exp(-ratio), 1.0]
    assert found == pytest.approx(expected, rel=1e-12)


def test_a_charge_is_beside_the_bias_and_its_rate_in_the_lowered_regressor() -> None:
    """(τ_λ p + 1) q/τ_λ is y + q/τ_λ."""
    learning = replace(SCALED_LEARNING, bias=True, charge=True)
    estimator = filled(learning, BATTERY).estimator
    assert estimator.sample.regressor[-2:] == [0.7, 1.0]
    assert estimator.rivals.lowered[-2:] == pytest.approx([0.7 + 3.3 / 3.0, 1.0], rel=1e-12)


def test_an_emf_wanders_along_the_bias_and_its_rise_along_both() -> None:
    """0.2 σ of the bias, and 0.1 σ of a rise that is zero at the present charge of 0.7."""
    learning = replace(SCALED_LEARNING, bias=True, charge=True)
    fresh = new_slow_state(replace(EXACT, learning=learning), BATTERY, 3.0, 280.0).estimator
    widened = covariance(filled(learning, BATTERY).estimator) - covariance(fresh)
    rise, bias = len(fresh.estimate.theta) - 2, len(fresh.estimate.theta) - 1
    expected = np.zeros_like(widened)
    expected[rise, rise] = 0.1**2
    expected[rise, bias] = expected[bias, rise] = -(0.1**2) * 0.7
    expected[bias, bias] = 0.2**2 + (0.1 * 0.7) ** 2
    np.testing.assert_allclose(widened, expected, atol=1e-9 * SCALED_LEARNING.initial_covariance)


@pytest.mark.parametrize(
    ("options", "share"),
    [
        ({}, 0.1),
        ({"charge": True}, 1.0),
        ({"drifts": True}, 1.0),
        ({"start_at_nominal": False}, 1.0),
        ({"initial_covariance": 1e7}, math.sqrt(0.1)),
        ({"initial_covariance": 1e4}, 1.0),
    ],
)
def test_an_offset_that_rests_is_expected_within_a_tenth_of_the_input(
    options: dict[str, Any], share: float
) -> None:
    """P[0] is a deviation of 1 at the least σ: an EMF or the drift of an inflow may be as large."""
    usual = {"alert": True, "bias": True, "initial_covariance": 1e8}
    learning = replace(SCALED_LEARNING, **(usual | options))
    state = est.new_estimator(learning, MOTOR, 2)
    variance = share**2 * learning.initial_covariance
    assert state.estimate.diagonal[-1] == pytest.approx(variance, rel=1e-12)
    state.estimate.diagonal[-1] = 1.0
    est.begin_anew(state, learning, MOTOR)
    assert state.estimate.diagonal[-1] == pytest.approx(variance, rel=1e-12)


@pytest.mark.parametrize("ceiling", [0.0, 0.5])
def test_a_ceiling_of_the_covariance_adds_its_information_to_each_sample(ceiling: float) -> None:
    learning = replace(SCALED_LEARNING, forgetting=0.9, covariance_max=ceiling)
    state = est.new_estimator(learning, MOTOR, 2)
    state.sample.regressor[:] = [-1.0, -0.9, 1.1]
    before = np.linalg.inv(covariance(state))
    est.learn(state, learning, MOTOR, 3.0, usable=True)
    information = 0.9 * before + np.outer(state.sample.regressor, state.sample.regressor)
    if ceiling > 0.0:
        information += 0.1 / ceiling * np.eye(3)
    np.testing.assert_allclose(np.linalg.inv(covariance(state)), information, rtol=1e-6, atol=1e-6)
    assert state.idle_periods == 0


def test_the_offset_of_the_input_is_what_bias_and_charge_move_the_output_by_over_beta() -> None:
    learning = replace(SCALED_LEARNING, bias=True, charge=True)
    state = filled(learning, BATTERY).estimator
    state.estimate.theta[:] = [-0.4, 0.3, 0.5, *state.estimate.theta[3:-2], 0.2, 0.1]
    offset_V = learning.method.input_offset(state, learning, BATTERY)
    assert offset_V == pytest.approx((0.1 + 0.2 * 0.7) / 0.8 * 280.0, rel=1e-12)
    without = replace(SCALED_LEARNING, bias=False)
    assert math.isnan(without.method.input_offset(state, without, BATTERY))
