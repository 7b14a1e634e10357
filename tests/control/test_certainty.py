"""How sure the physical parameters are, against numpy's propagation of the covariance of θ."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.branch import Branch
from adaptdrive.control.certainty import deviations_of, is_sure
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


def test_a_large_parameter_is_moved_in_proportion() -> None:
    """Rounding of a value of 1e9 would hide a step of a millionth."""
    learning = replace(UNBIASED, output_scale=1e-9)
    one = estimate(learning)
    assert abs(one.theta[2]) > 1e8
    found = deviations_of(one, NOISE, learning, MOTOR, VALUES)
    assert found[1:] == pytest.approx(propagated(learning)[1:], rel=1e-4)
    assert found[0] == pytest.approx(propagated(learning)[0], rel=0.01)


@pytest.mark.parametrize("learning", KINDS)
@pytest.mark.parametrize(("share", "sure"), [(0.499, True), (0.501, False)])
def test_it_is_sure_of_parameters_that_are_all_known_within_half(
    learning: Learning, share: float, *, sure: bool
) -> None:
    worst = float(np.max(propagated(learning) / np.abs(VALUES)))
    power = (NOISE * share / worst) ** 2
    assert is_sure(estimate(learning), power, learning, MOTOR) is sure


def test_the_sign_of_a_parameter_says_nothing_about_how_sure_it_is() -> None:
    one = estimate(UNBIASED)
    one.theta[2] = -one.theta[2]
    assert is_sure(one, 1e-12, UNBIASED, MOTOR)


@pytest.mark.parametrize("level", [0.0, 1e-13])
def test_nobody_is_sure_of_a_load_without_a_gain_at_rest(level: float) -> None:
    """1 + α_1 + α_2 = 0 is a pole at s = 0."""
    theta = [level * UNBIASED.tau_lambda_s**2 - 1.0, 0.0, 1.0]
    upper = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    assert is_sure(Branch(theta, upper, [0.0] * 3), 0.0, UNBIASED, MOTOR) is False


def test_a_load_next_to_one_without_a_gain_has_unknown_deviations() -> None:
    theta = [-1e-6 - 1.0, 0.0, 1.0]
    upper = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    values = list(physical(np.array(theta), UNBIASED))
    found = deviations_of(Branch(theta, upper, [1e-6] * 3), 1.0, UNBIASED, MOTOR, values)
    assert len(found) == 3
    assert all(math.isnan(one) for one in found)
    assert not is_sure(Branch(theta, upper, [0.0] * 3), 0.0, UNBIASED, MOTOR)
