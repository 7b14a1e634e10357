"""The estimate whose bias walks, learnt from samples of a simulated bath with a moving inflow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control import estimator as est
from adaptdrive.control import fast_half as fast
from adaptdrive.control import in_force
from adaptdrive.control import regression as reg
from adaptdrive.control.integrated import applies
from adaptdrive.control.loads.bath import bath_load
from tests.closed_loop.bench import SCALED_LEARNING
from tests.control.systems import Array, row_norms

R, TAU_s = 0.021, 500.0
BATH = bath_load(R, TAU_s, 0.25, 1.0, 7.87)
TICK_s, TICKS, SECONDS = 0.5, 40, 14400
LEARNING = replace(
    SCALED_LEARNING,
    tau_lambda_s=100.0,
    output_scale=12.0,
    input_scale=570.0,
    initial_covariance=1e8,
    gate=1.2,
    bias=True,
    initial_state=True,
    alert=True,
)
TIMES_s = np.arange(0.0, SECONDS, TICK_s)
POWER_W = 520.0 + 60.0 * np.sign(np.sin(2.0 * math.pi * TIMES_s / 2400.0))


def outputs(inflow_K: Array, noise_K: float, seed: int) -> Array:
    """Temperature of a first-order bath at the ticks: the held heater and the inflow."""
    held = math.exp(-TICK_s / TAU_s)
    heated_K = lfilter([0.0, R * (1.0 - held)], [1.0, -held], POWER_W - 520.0) + R * 520.0
    cooled_K = lfilter([1.0 - held], [1.0, -held], inflow_K - inflow_K[0]) + inflow_K[0]
    noise = np.random.default_rng(seed).normal(0.0, noise_K, TIMES_s.size)
    return np.asarray(heated_K + cooled_K + noise)


def learnt(inflow_K: Array, noise_K: float = 0.002, seed: int = 7) -> est.EstimatorState:
    """Learn the bath from its samples."""
    course, learning = outputs(inflow_K, noise_K, seed), LEARNING
    state = est.new_estimator(learning, BATH, 2)
    bank = fast.new_filter_bank(BATH, TICK_s, 100.0, float(course[0]), float(POWER_W[0]))
    for n in range(1, TIMES_s.size):
        fast.filter_sample(bank, float(course[n]), float(POWER_W[n]), 1)
        if n % TICKS:
            continue
        fast.accumulate(bank)
        y, *rest = fast.take_means(bank)
        state.sample.time_s += TICKS * TICK_s
        reg.fill_filtered_regressor(state.sample.regressor, learning, BATH, rest[:1], rest[1:])
        reg.fill_initial_state(
            state.sample.regressor, learning, BATH, state.sample.time_s - state.estimate.origin_s
        )
        reg.fill_lowered_regressor(state.rivals.lowered, learning, BATH, y, rest[:1], rest[1:])
        est.learn(state, learning, BATH, y, usable=True)
    return state


def values(theta: list[float]) -> list[float]:
    """R and τ of an estimate."""
    return BATH.physical(*reg.filtered_model(theta, LEARNING, BATH))


@pytest.mark.parametrize("period_s", [900.0, 1700.0])
def test_it_finds_the_load_under_an_inflow_that_swings(period_s: float) -> None:
    worst = 0.0
    for seed in (0, 1, 7):
        state = learnt(0.1 * np.sin(2.0 * math.pi * TIMES_s / period_s), seed=seed)
        assert state.integrated.in_force
        assert values(in_force.in_force(state).theta) == pytest.approx([R, TAU_s], rel=0.05)
        resting = np.array(values(state.estimate.theta))
        worst = max(worst, float(np.max(np.abs(resting / [R, TAU_s] - 1.0))))
    assert worst > 0.08  # where the bias rests; the other estimate is within 5 %


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise_K", [0.0, 0.002, 0.05])
def test_it_leaves_a_bias_that_rests_to_the_other_estimate(seed: int, noise_K: float) -> None:
    state = learnt(np.zeros_like(TIMES_s), noise_K, seed)
    assert not state.integrated.in_force
    assert in_force.in_force(state) is state.estimate


def test_what_is_in_force_is_what_is_shown() -> None:
    state = learnt(0.5 * np.sin(2.0 * math.pi * TIMES_s / 900.0))
    branch = state.integrated.branch
    assert state.innovation == branch.innovation * LEARNING.output_scale
    assert in_force.in_force(state) is branch
    deviations = row_norms(in_force.parameter_root(state, LEARNING, BATH, values(branch.theta)))
    assert np.all(np.array(deviations) > 0.0)


def test_an_estimate_that_begins_anew_lets_it_begin_anew_too() -> None:
    state = learnt(0.5 * np.sin(2.0 * math.pi * TIMES_s / 900.0))
    est.begin_anew(state, LEARNING, BATH)
    assert not state.integrated.in_force
    assert state.integrated.samples == 0


@pytest.mark.parametrize(("bias", "charge"), [(False, False), (True, True), (False, True)])
def test_only_a_bias_that_is_not_an_emf_walks(bias: bool, charge: bool) -> None:
    assert applies(LEARNING)
    assert not applies(replace(LEARNING, bias=bias, charge=charge))
