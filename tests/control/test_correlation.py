"""Deviations shown under innovations that resemble their neighbours, against numpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.doubt import doubted_deviations
from adaptdrive.control.estimator import EstimatorState, new_estimator, remember_residual
from adaptdrive.control.in_force import correlation_factor
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LONG = replace(SCALED_LEARNING, forgetting=0.9995)


def neighbours(correlation: float, shape: tuple[int, int], seed: int) -> Array:
    """Draw rows whose samples have this correlation with the one before, and variance 1."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    rows = np.empty(shape)
    rows[:, 0] = noise[:, 0]
    for i in range(1, shape[1]):
        rows[:, i] = correlation * rows[:, i - 1] + math.sqrt(1.0 - correlation**2) * noise[:, i]
    return rows


def fed(innovations: Array) -> EstimatorState:
    """Return an estimator that has seen these innovations, each of them certain."""
    state = new_estimator(LONG, MOTOR, 2)
    for one in innovations:
        state.estimate.innovation = float(one)
        remember_residual(state, state.estimate, LONG.forgetting)
    return state


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.6, 0.8])
def test_a_mean_is_as_uncertain_as_the_factor_says(correlation: float) -> None:
    """The spread of the means of 2000 rows, over that of independent samples."""
    spread = neighbours(correlation, (2000, 200), 91).mean(axis=1).std() * math.sqrt(200)
    found = correlation_factor(fed(neighbours(correlation, (1, 6000), 92)[0]))
    assert found == pytest.approx(spread, rel=0.08)


def test_innovations_of_alternating_sign_narrow_nothing() -> None:
    assert correlation_factor(fed(np.resize([1.0, -1.0], 500))) == 1.0


def test_innovations_that_are_all_alike_are_one_sample() -> None:
    state = fed(np.full(500, 0.1))
    assert correlation_factor(state) == pytest.approx(math.sqrt(state.residual_weight), rel=0.01)


def test_the_deviations_shown_are_wider_by_the_factor() -> None:
    state, values = fed(np.full(500, 0.1)), [0.011, 33.4, 234.0]
    wide = doubted_deviations(state, LONG, MOTOR, values)
    factor = correlation_factor(state)
    state.residual_lag = 0.0
    known = doubted_deviations(state, LONG, MOTOR, values)
    assert np.array(wide) == pytest.approx(factor * np.array(known), rel=1e-6)
    assert factor > 10.0
