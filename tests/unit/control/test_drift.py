"""A bath whose inflow drifts: an offset that walks, learnt from samples of a simulated plant."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.settings import EstimatorSettings
from tests.unit.control.learning import (
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
from tests.unit.control.systems import Array

SECONDS = 21600
SEEDS = range(700, 704)
DRIFTS = replace(BATH_LEARNING, drifts=True)


@dataclass
class Course:
    """Errors of R and RC in the last three hours, relative and in shown deviations."""

    relative: Array
    counted: Array


def simulated(drift_K_per_h: float, noise_K: float, seed: int) -> tuple[Array, Array]:
    """Heater power and temperature at the ticks: a square wave, and an inflow that turns."""
    random = np.random.default_rng(seed)
    times = np.arange(0.0, SECONDS, BATH_TICK_s)
    period_s, turn_s = random.uniform(2000.0, 2800.0), random.uniform(2700.0, 4500.0)
    phase, turn_phase = random.uniform(0.0, 1.0), random.uniform(0.0, 2.0)
    power = 520.0 + 60.0 * np.sign(np.sin(2.0 * math.pi * (times / period_s + phase)))
    triangle = 0.5 - np.abs((times / turn_s + turn_phase) % 2.0 - 1.0)
    inflow_K = drift_K_per_h * turn_s / 3600.0 * triangle
    return power, bath_temperatures(power, inflow_K, random.normal(0.0, noise_K, times.size))


def course(
    learning: EstimatorSettings, drift_K_per_h: float, noise_K: float = 0.0, seed: int = 7
) -> Course:
    """Learn a bath whose dynamics stand still."""
    samples = simulated(drift_K_per_h, noise_K, seed)
    estimator, relative, counted = LambdaEstimator(learning, BATH, 2), [], []
    for n in learn_course(estimator, samples, tick_s=BATH_TICK_s, ticks=BATH_TICKS):
        if n * BATH_TICK_s > 0.5 * SECONDS:
            own, residuals = estimator.estimate, estimator.residuals
            found = bath_values(estimator, own.theta)
            sigma = math.sqrt(residuals.power / (residuals.weight - len(own.theta)))
            deviations = estimator.regression.deviations(own, sigma, found)
            wrong = np.abs(np.array(found) - [R, TAU_s])
            relative.append(np.max(wrong / [R, TAU_s]))
            counted.append(np.max(wrong / deviations))
    return Course(np.array(relative), np.array(counted))


@pytest.mark.parametrize("noise_K", [0.02, 0.1])
def test_the_deviations_hold_what_a_drifting_inflow_does(noise_K: float) -> None:
    """Medians over four baths; without noise the deviations hold it with no kind of offset."""
    known = [course(DRIFTS, 1.0, noise_K, seed) for seed in SEEDS]
    ignored = [course(BATH_LEARNING, 1.0, noise_K, seed) for seed in SEEDS]
    assert middle_count(known) < 0.5 * middle_count(ignored)
    assert middle_error(known) < 0.25


def middle_count(courses: list[Course]) -> float:
    return float(np.median([np.median(one.counted) for one in courses]))


def middle_error(courses: list[Course]) -> float:
    return float(np.median([np.median(one.relative) for one in courses]))


TIMES_s = np.arange(0.0, 14400.0, BATH_TICK_s)
POWER_W = 520.0 + 60.0 * np.sign(np.sin(2.0 * math.pi * TIMES_s / 2400.0))


def learnt(inflow_K: Array, noise_K: float = 0.002, seed: int = 7) -> LambdaEstimator:
    """Learn the bath from its samples."""
    noise = np.random.default_rng(seed).normal(0.0, noise_K, TIMES_s.size)
    course = POWER_W, bath_temperatures(POWER_W, inflow_K, noise)
    estimator = LambdaEstimator(BATH_LEARNING, BATH, 2)
    for _ in learn_course(estimator, course, tick_s=BATH_TICK_s, ticks=BATH_TICKS):
        pass
    return estimator


@pytest.mark.parametrize("period_s", [900.0, 1700.0])
def test_it_finds_the_load_under_an_inflow_that_swings(period_s: float) -> None:
    worst = 0.0
    for seed in (0, 1, 7):
        found = learnt(0.1 * np.sin(2.0 * math.pi * TIMES_s / period_s), seed=seed)
        assert found.incremental.in_force
        assert bath_values(found, found.in_force.theta) == pytest.approx([R, TAU_s], rel=0.05)
        resting = np.array(bath_values(found, found.estimate.theta))
        worst = max(worst, float(np.max(np.abs(resting / [R, TAU_s] - 1.0))))
    if period_s < 1000.0:  # a slower swing does less to the estimate whose bias rests
        assert worst > 0.06


@pytest.mark.parametrize(("seed", "noise_K"), [(0, 0.0), (1, 0.002), (2, 0.05), (3, 0.05)])
def test_it_leaves_a_bias_that_rests_to_the_other_estimate(seed: int, noise_K: float) -> None:
    found = learnt(np.zeros_like(TIMES_s), noise_K, seed)
    assert not found.incremental.in_force
    assert found.in_force is found.estimate
