"""A bath whose inflow drifts: an offset that walks, learnt from samples of a simulated plant."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control import estimator as est
from adaptdrive.control import fast_half as fast
from adaptdrive.control import regression as reg
from adaptdrive.control.certainty import deviations_of
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.settings import Learning
from tests.closed_loop.bench import SCALED_LEARNING
from tests.control.systems import Array

R, TAU_s = 0.021, 500.0
BATH = bath_load(R, TAU_s, 0.25, 1.0, 7.87)
TICK_s, TICKS, SECONDS = 0.5, 40, 21600
SEEDS = range(700, 704)
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
DRIFTS = replace(LEARNING, drifts=True)


@dataclass
class Course:
    """Errors of R and RC in the last three hours, relative and in shown deviations."""

    relative: Array
    counted: Array


def simulated(drift_K_per_h: float, noise_K: float, seed: int) -> tuple[Array, Array]:
    """Heater power and temperature at the ticks: a square wave, and an inflow that turns."""
    random = np.random.default_rng(seed)
    times = np.arange(0.0, SECONDS, TICK_s)
    period_s, turn_s = random.uniform(2000.0, 2800.0), random.uniform(2700.0, 4500.0)
    phase, turn_phase = random.uniform(0.0, 1.0), random.uniform(0.0, 2.0)
    power = 520.0 + 60.0 * np.sign(np.sin(2.0 * math.pi * (times / period_s + phase)))
    triangle = 0.5 - np.abs((times / turn_s + turn_phase) % 2.0 - 1.0)
    inflow_K = drift_K_per_h * turn_s / 3600.0 * triangle
    held = math.exp(-TICK_s / TAU_s)
    heated_K = lfilter([0.0, R * (1.0 - held)], [1.0, -held], power - 520.0) + R * 520.0
    cooled_K = lfilter([1.0 - held], [1.0, -held], inflow_K - inflow_K[0]) + inflow_K[0]
    return power, heated_K + cooled_K + random.normal(0.0, noise_K, times.size)


def course(learning: Learning, drift_K_per_h: float, noise_K: float = 0.0, seed: int = 7) -> Course:
    """Learn a bath whose dynamics stand still."""
    powers, outputs = simulated(drift_K_per_h, noise_K, seed)
    state = est.new_estimator(learning, BATH, 2)
    bank = fast.new_filter_bank(BATH, TICK_s, 100.0, float(outputs[0]), float(powers[0]))
    relative, counted = [], []
    for n in range(1, powers.size):
        fast.filter_sample(bank, float(outputs[n]), float(powers[n]), 1)
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
        if n * TICK_s > 0.5 * SECONDS:
            found = BATH.physical(*reg.filtered_model(state.estimate.theta, learning, BATH))
            sigma = math.sqrt(
                state.residual_power / (state.residual_weight - len(state.estimate.theta))
            )
            deviations = deviations_of(state.estimate, sigma, learning, BATH, found)
            wrong = np.abs(np.array(found) - [R, TAU_s])
            relative.append(np.max(wrong / [R, TAU_s]))
            counted.append(np.max(wrong / deviations))
    return Course(np.array(relative), np.array(counted))


@pytest.mark.parametrize("noise_K", [0.02, 0.1])
def test_the_deviations_hold_what_a_drifting_inflow_does(noise_K: float) -> None:
    """Medians over four baths; without noise the deviations hold it with no kind of offset."""
    known = [course(DRIFTS, 1.0, noise_K, seed) for seed in SEEDS]
    ignored = [course(LEARNING, 1.0, noise_K, seed) for seed in SEEDS]
    assert middle_count(known) < 0.5 * middle_count(ignored)
    assert middle_error(known) < 0.25


def middle_count(courses: list[Course]) -> float:
    return float(np.median([np.median(one.counted) for one in courses]))


def middle_error(courses: list[Course]) -> float:
    return float(np.median([np.median(one.relative) for one in courses]))


def test_an_inflow_that_stands_leaves_the_estimate_right() -> None:
    assert np.max(course(DRIFTS, 0.0).relative) < 0.005
    assert np.max(course(DRIFTS, 0.0, 0.02).relative) < 0.04
