"""The estimate whose bias walks, learnt from samples of a simulated bath with a moving inflow."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adaptdrive.control import estimator as est
from adaptdrive.control import in_force
from tests.control.learning import (
    BATH,
    BATH_LEARNING,
    BATH_TICKS,
    BATH_TICK_s,
    R,
    TAU_s,
    bath_temperatures,
    bath_values,
    learn_course,
)
from tests.control.systems import Array, row_norms

TIMES_s = np.arange(0.0, 14400.0, BATH_TICK_s)
POWER_W = 520.0 + 60.0 * np.sign(np.sin(2.0 * math.pi * TIMES_s / 2400.0))


def learnt(inflow_K: Array, noise_K: float = 0.002, seed: int = 7) -> est.EstimatorState:
    """Learn the bath from its samples."""
    noise = np.random.default_rng(seed).normal(0.0, noise_K, TIMES_s.size)
    course = POWER_W, bath_temperatures(POWER_W, inflow_K, noise)
    state = est.new_estimator(BATH_LEARNING, BATH, 2)
    for _ in learn_course(state, BATH_LEARNING, BATH, course, tick_s=BATH_TICK_s, ticks=BATH_TICKS):
        pass
    return state


@pytest.mark.parametrize("period_s", [900.0, 1700.0])
def test_it_finds_the_load_under_an_inflow_that_swings(period_s: float) -> None:
    worst = 0.0
    for seed in (0, 1, 7):
        state = learnt(0.1 * np.sin(2.0 * math.pi * TIMES_s / period_s), seed=seed)
        assert state.integrated.in_force
        assert bath_values(in_force.in_force(state).theta) == pytest.approx([R, TAU_s], rel=0.05)
        resting = np.array(bath_values(state.estimate.theta))
        worst = max(worst, float(np.max(np.abs(resting / [R, TAU_s] - 1.0))))
    assert worst > 0.08  # where the bias rests; the other estimate is within 5 %


@pytest.mark.parametrize(("seed", "noise_K"), [(0, 0.0), (1, 0.002), (2, 0.05), (3, 0.05)])
def test_it_leaves_a_bias_that_rests_to_the_other_estimate(seed: int, noise_K: float) -> None:
    state = learnt(np.zeros_like(TIMES_s), noise_K, seed)
    assert not state.integrated.in_force
    assert in_force.in_force(state) is state.estimate


def test_what_is_in_force_is_what_is_shown() -> None:
    state = learnt(0.5 * np.sin(2.0 * math.pi * TIMES_s / 900.0))
    branch = state.integrated.branch
    assert state.innovation == branch.innovation * BATH_LEARNING.output_scale
    assert in_force.in_force(state) is branch
    deviations = row_norms(
        in_force.parameter_root(state, BATH_LEARNING, BATH, bath_values(branch.theta))
    )
    assert np.all(np.array(deviations) > 0.0)


def test_an_estimate_that_begins_anew_lets_it_begin_anew_too() -> None:
    state = learnt(0.5 * np.sin(2.0 * math.pi * TIMES_s / 900.0))
    est.begin_anew(state, BATH_LEARNING, BATH)
    assert not state.integrated.in_force
    assert state.integrated.samples == 0


@pytest.mark.parametrize("excitation", [0.0, 0.5, 30.0])
def test_the_residual_is_the_noise_that_would_make_such_an_innovation(excitation: float) -> None:
    """ε² has the mean σ² (1 + rᵀPr/ρ)."""
    state, sigma = est.new_estimator(BATH_LEARNING, BATH, 2), 0.01
    spread = sigma * math.sqrt(1.0 + excitation / BATH_LEARNING.forgetting)
    state.innovation, state.excitation = spread * BATH_LEARNING.output_scale, excitation
    assert in_force.own_residual(state, BATH_LEARNING) == pytest.approx(sigma**2)
