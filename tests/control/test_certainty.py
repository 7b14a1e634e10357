"""How sure the physical parameters are, against numpy's propagation of the covariance of θ."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.branch import Branch
from adaptdrive.control.certainty import deviations_of, is_sure
from adaptdrive.control.doubt import doubted_deviations
from adaptdrive.control.estimator import EstimatorState, new_estimator, remember_residual
from adaptdrive.control.in_force import correlation_factor
from adaptdrive.control.regression import filtered_model, theta_of
from adaptdrive.control.settings import Learning
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

VALUES = [0.011, 33.4, 234.0]
UPPER = [1.0, 0.3, -0.2, 0.0, 1.0, 0.4, 0.0, 0.0, 1.0]
DIAGONAL = [2e-4, 5e-5, 1e-5]
NOISE = 0.05
UNBIASED = replace(SCALED_LEARNING, tau_lambda_s=8.0)
KINDS = [UNBIASED, replace(UNBIASED, bias=True), replace(UNBIASED, short_lag_s=10.0)]


def estimate(learning: Learning) -> Branch:
    """θ of a motor with two disks, U and D, the last for a bias or cut to two parameters."""
    theta = theta_of(learning, MOTOR, *MOTOR.realise(VALUES))
    theta += [0.0] if learning.bias else []
    size = len(theta)
    upper = np.eye(size)
    part = min(size, 3)
    upper[:part, :part] = np.reshape(UPPER, (3, 3))[:part, :part]
    return Branch(theta, list(upper.ravel()), [*DIAGONAL, 3e-5][:size])


def physical(theta: Array, learning: Learning) -> Array:
    return np.array(MOTOR.physical(*filtered_model(list(theta), learning, MOTOR)))


def propagated(learning: Learning) -> Array:
    """Deviations by central differences and the full covariance."""
    one = estimate(learning)
    theta = np.array(one.theta)
    u = np.reshape(one.upper, (len(theta), len(theta)))
    root = NOISE * u @ np.diag(np.sqrt(one.diagonal))
    columns = []
    for direction in root.T:
        step = 1e-3 * direction
        ahead, behind = physical(theta + step, learning), physical(theta - step, learning)
        columns.append((ahead - behind) / 2e-3)
    return np.asarray(np.sqrt(np.sum(np.square(columns), axis=0)))


@pytest.mark.parametrize("learning", KINDS)
def test_deviations_are_those_of_the_propagated_covariance(learning: Learning) -> None:
    found = deviations_of(estimate(learning), NOISE, learning, MOTOR, VALUES)
    assert found == pytest.approx(propagated(learning), rel=1e-4)


@pytest.mark.parametrize("learning", KINDS)
@pytest.mark.parametrize(("share", "sure"), [(0.499, True), (0.501, False)])
def test_it_is_sure_of_parameters_that_are_all_known_within_half(
    learning: Learning, share: float, *, sure: bool
) -> None:
    worst = float(np.max(propagated(learning) / np.abs(VALUES)))
    power = (NOISE * share / worst) ** 2
    assert is_sure(estimate(learning), power, learning, MOTOR) is sure


@pytest.mark.parametrize("level", [0.0, 1e-13, -1e-6])
def test_nobody_is_sure_of_a_load_without_a_gain_at_rest(level: float) -> None:
    """1 + α_1 + α_2 = 0 is a pole at s = 0."""
    theta = [level - 1.0, 0.0, 1.0]
    upper = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert is_sure(Branch(theta, upper, [0.0] * 3), 0.0, UNBIASED, MOTOR) is False


def test_a_load_next_to_one_without_a_gain_has_unknown_deviations() -> None:
    theta = [-1e-6 - 1.0, 0.0, 1.0]
    upper = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    values = list(physical(np.array(theta), UNBIASED))
    found = deviations_of(Branch(theta, upper, [1e-6] * 3), 1.0, UNBIASED, MOTOR, values)
    assert len(found) == 3
    assert all(math.isnan(one) for one in found)


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
