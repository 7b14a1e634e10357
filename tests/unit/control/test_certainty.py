"""What a covariance leaves open of parameters and of the loop, against numpy and scipy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.control.design.pole_placement import Plant, discrete_model, possible_plants
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.estimation.regression import Regression
from adaptdrive.control.estimation.rls import Estimate
from adaptdrive.control.settings import EstimatorSettings
from tests.integration.closed_loop.bench import EXACT, MOTOR, SCALED_LEARNING
from tests.unit.control.systems import Array

VALUES = [0.011, 33.4, 234.0]
UPPER = [1.0, 0.3, -0.2, 0.0, 1.0, 0.4, 0.0, 0.0, 1.0]
DIAGONAL = [2e-4, 5e-5, 1e-5]
NOISE = 0.05
UNBIASED = replace(SCALED_LEARNING, tau_lambda_s=8.0)
KINDS = [UNBIASED, replace(UNBIASED, bias=True), replace(UNBIASED, short_lag_s=10.0)]


def estimate(regression: Regression) -> Estimate:
    """θ of a motor with two disks, U and D, the last for a bias or cut to two parameters."""
    size = regression.size
    upper = np.eye(size)
    part = min(size, 3)
    upper[:part, :part] = np.reshape(UPPER, (3, 3))[:part, :part]
    one = Estimate(size)
    one.theta[: regression.first] = regression.theta_of(*MOTOR.realise(VALUES))
    one.upper[:], one.diagonal[:] = list(upper.ravel()), [*DIAGONAL, 3e-5][:size]
    return one


def physical(theta: Array, regression: Regression) -> Array:
    return np.array(MOTOR.physical(*regression.model(list(theta))))


def propagated(regression: Regression) -> Array:
    """Deviations by central differences and the full covariance."""
    one = estimate(regression)
    theta = np.array(one.theta)
    u = np.reshape(one.upper, (len(theta), len(theta)))
    root = NOISE * u @ np.diag(np.sqrt(one.diagonal))
    columns = []
    for direction in root.T:
        step = 1e-3 * direction
        ahead, behind = physical(theta + step, regression), physical(theta - step, regression)
        columns.append((ahead - behind) / 2e-3)
    return np.asarray(np.sqrt(np.sum(np.square(columns), axis=0)))


@pytest.mark.parametrize("learning", KINDS)
def test_deviations_are_those_of_the_propagated_covariance(learning: EstimatorSettings) -> None:
    regression = Regression(learning, MOTOR)
    found = regression.deviations(estimate(regression), NOISE, VALUES)
    assert found == pytest.approx(propagated(regression), rel=1e-4)


LONG = replace(SCALED_LEARNING, forgetting=0.9995)


def neighbours(correlation: float, shape: tuple[int, int], seed: int) -> Array:
    """Draw rows whose samples have this correlation with the one before, and variance 1."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    rows = np.empty(shape)
    rows[:, 0] = noise[:, 0]
    for i in range(1, shape[1]):
        rows[:, i] = correlation * rows[:, i - 1] + math.sqrt(1.0 - correlation**2) * noise[:, i]
    return rows


def fed(innovations: Array) -> LambdaEstimator:
    """Return an estimator that has seen these innovations, each of them certain."""
    estimator = LambdaEstimator(LONG, MOTOR, 2)
    for one in innovations:
        estimator.estimate.innovation = float(one)
        estimator.residuals.remember(estimator.estimate, LONG.forgetting)
    return estimator


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.6, 0.8])
def test_a_mean_is_as_uncertain_as_the_factor_says(correlation: float) -> None:
    """The spread of the means of 2000 rows, over that of independent samples."""
    spread = neighbours(correlation, (2000, 200), 91).mean(axis=1).std() * math.sqrt(200)
    found = fed(neighbours(correlation, (1, 6000), 92)[0]).residuals.correlation_factor()
    assert found == pytest.approx(spread, rel=0.08)


def test_the_deviations_shown_are_wider_by_the_factor() -> None:
    estimator, values = fed(np.full(500, 0.1)), [0.011, 33.4, 234.0]
    wide = estimator.shown_deviations(values)
    factor = estimator.residuals.correlation_factor()
    estimator.residuals.lag = 0.0
    known = estimator.shown_deviations(values)
    assert np.array(wide) == pytest.approx(factor * np.array(known), rel=1e-6)
    assert factor > 10.0


BOLD = replace(EXACT, supervision=replace(EXACT.supervision, confidence=2.0))


HEAVY = [0.011, 33.4, 234.0]
ENCODER = [0.011, 23.5, 2.35]


def spread(values: list[float], root: Array, pole: float = 0.7) -> float:
    """How far the response may be off with the gains for a motor."""
    plant = Plant(*discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0))
    possible = possible_plants(BOLD, MOTOR, values, list(root.ravel()), 1.0)
    return plant.response_spread(possible, plant.asked(pole), pole)


def responses(values: list[float], loads: Array, pole: float = 0.7) -> Array:
    """Responses of loads to a step, with the gains for a motor, by scipy."""
    plant = Plant(*discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0))
    r, s = plant.place(plant.asked(pole))
    found = []
    for load in loads:
        a, b = discrete_model(BOLD, MOTOR, *MOTOR.realise(load.tolist()), 1.0)
        forward, back = np.convolve(a, r), np.convolve(b, s)
        closed = forward + np.pad(back, (0, len(forward) - len(back)))
        found.append(lfilter(sum(s) * np.array(b), closed, np.ones(60)))
    return np.array(found)


def test_it_is_the_deviation_that_drawn_loads_show() -> None:
    """Two standard deviations, at the sample where they are largest."""
    random = np.random.default_rng(2)
    root = np.tril([[2e-4, 0, 0], [0.5, 0.3, 0], [3.0, 2.0, 6.0]])
    loads = HEAVY + random.normal(size=(2000, 3)) @ root.T
    shown = 2.0 * np.std(responses(HEAVY, loads), axis=0).max()
    assert spread(HEAVY, root) == pytest.approx(shown, rel=0.05)


def test_what_grows_together_without_the_loop_seeing_it_counts_for_little() -> None:
    """A gain and time constants that are all 8 % larger, beside a time constant alone."""
    together, alone = np.zeros((3, 3)), np.zeros((3, 3))
    together[:, 0] = 0.08 * np.array(HEAVY)
    alone[1, 1] = 0.08 * HEAVY[1]
    assert spread(HEAVY, together) < 0.4 * spread(HEAVY, alone)


def test_a_second_lag_near_0_may_be_as_uncertain_as_it_likes() -> None:
    root = np.diag([0.0, 0.0, 0.8 * ENCODER[2]])
    assert spread(ENCODER, root) < 0.02


def test_a_load_within_the_covariance_that_the_loop_does_not_hold_leaves_all_open() -> None:
    assert spread(HEAVY, np.diag([0.0, 0.0, 80.0]), 0.4) == math.inf


def test_a_covariance_that_is_not_known_leaves_all_open() -> None:
    assert spread(HEAVY, np.full((3, 3), np.nan)) == math.inf
