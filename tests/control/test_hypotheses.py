"""What a change leaves in the λ filters, against scipy; and the algebra of P, against numpy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lsim

from adaptdrive.control import rls
from adaptdrive.control.hypotheses import (
    BOTH,
    DISTURBANCE,
    LOAD,
    NOTHING,
    Anchor,
    Branch,
    restart_past,
    widen,
)
from adaptdrive.control.regression import theta_of
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LEARNING = replace(SCALED_LEARNING, bias=True, alert=True, initial_state=True)
STEP_S, TAU_S = 0.01, 10.0
CHANGE = 6000
"""Sample of the change."""


def lagged(signal: Array) -> Array:
    """A signal after the λ filter, from rest."""
    time_s = np.arange(len(signal)) * STEP_S
    _, rising, _ = lsim(([1.0], [TAU_S, 1.0]), signal - signal[0], time_s)
    answer: Array = signal[0] + rising
    return answer


def regressors(outputs: Array, voltages: Array) -> tuple[Array, Array]:
    """R and the lowered r of every sample, scaled, without γ."""
    y, u = outputs / LEARNING.output_scale, voltages / LEARNING.input_scale
    y1, u1 = lagged(y), lagged(u)
    one = np.ones_like(y)
    plain = np.stack([-y1, -lagged(y1), lagged(u1), 0 * one, 0 * one, one], 1)
    return plain, np.stack([-y, -y1, u1, 0 * one, 0 * one, one], 1)


def theta(disks: int, offset_V: float) -> Array:
    numerator, denominator = [0.0, 0.0, 0.011 / (117.0 * disks)], [1.0, 0.0, 0.0]
    product = 117.0 * disks
    denominator[1:] = [(11.7 * disks + 10.0) / product, 1.0 / product]
    values = theta_of(LEARNING, MOTOR, numerator, denominator)
    return np.array([*values, 0.0, 0.0, values[2] * offset_V / LEARNING.input_scale])


def course(disks: tuple[int, int], offsets_V: tuple[float, float]) -> tuple[Array, Array]:
    """Voltage and output of a motor whose inertia and torque jump while it moves."""
    time_s = np.arange(CHANGE + 4000) * STEP_S
    voltages = 280.0 + 15.0 * np.sin(2.0 * math.pi * time_s / 40.0)
    outputs, state = np.empty_like(voltages), np.full(2, 0.011 * (280.0 + offsets_V[0]))
    for part, piece in enumerate((slice(0, CHANGE + 1), slice(CHANGE, None))):
        motor_s = 11.7 * disks[part]
        motion = (
            [[-1.0 / motor_s, 0.0], [0.1, -0.1]],
            [[0.011 / motor_s], [0.0]],
            [[0.0, 1.0]],
            [[0.0]],
        )
        driven = voltages[piece] + offsets_V[part]
        elapsed_s = time_s[piece] - time_s[piece][0]
        _, outputs[piece], states = lsim(motion, driven, elapsed_s, state)
        state = states[-1]
    return voltages, outputs


@pytest.mark.parametrize(
    ("disks", "offsets_V"),
    [((1, 3), (0.0, 0.0)), ((3, 1), (-20.0, -20.0)), ((2, 2), (0.0, -20.0)), ((1, 2), (0.0, 15.0))],
)
def test_what_a_change_leaves_follows_from_the_change(
    disks: tuple[int, int], offsets_V: tuple[float, float]
) -> None:
    voltages, outputs = course(disks, offsets_V)
    plain, lowered = regressors(outputs, voltages)
    old, new = theta(disks[0], offsets_V[0]), theta(disks[1], offsets_V[1])
    error = outputs / LEARNING.output_scale - plain @ new
    step = new - old
    h = np.arange(4000) * STEP_S / TAU_S
    left = -(plain[CHANGE] @ step + h * (lowered[CHANGE] @ step)) * np.exp(-h)
    assert np.max(np.abs(left)) > 0.002
    np.testing.assert_allclose(error[CHANGE:], left, atol=2e-5)


def branch(count: int = 6, variance: float = 1e-6) -> Branch:
    upper = np.eye(count).ravel().tolist()
    return Branch(theta(2, 0.0).tolist(), upper, [variance] * count)


def anchor() -> Anchor:
    voltages, outputs = course((2, 2), (0.0, 0.0))
    plain, lowered = regressors(outputs, voltages)
    return Anchor(plain[CHANGE].tolist(), lowered[CHANGE].tolist(), power=1e-8, gap_s=1.0)


def doubt(kind: int, direction: Array) -> float:
    """Standard deviation along a direction of θ after widening, in units of σ."""
    one = branch()
    widen(one, kind, LEARNING, MOTOR, anchor())
    return math.sqrt(rls.excitation(one.upper, one.diagonal, direction.tolist()))


def test_each_kind_of_change_doubts_what_it_may_have_moved() -> None:
    bias = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    dynamics = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert doubt(NOTHING, bias) == pytest.approx(1e-3)
    assert doubt(NOTHING, dynamics) == pytest.approx(1e-3)
    assert doubt(DISTURBANCE, bias) > 100.0
    assert doubt(DISTURBANCE, dynamics) == pytest.approx(1e-3)
    assert doubt(LOAD, dynamics) > 1000.0
    assert doubt(BOTH, bias) > 100.0


def test_another_load_keeps_gain_and_offset() -> None:
    """The derivative of the output at rest by a change of the load is 0."""
    at_rest = np.array([-0.92, -0.92, 0.92, 0.0, 0.0, 0.0])
    values = theta(2, 0.0)
    gain = values[2] / (1.0 + values[0] + values[1])
    at_rest[2] = 0.92 / gain
    assert doubt(LOAD, at_rest) < 0.01
    assert doubt(BOTH, at_rest) > 100.0


@given(st.floats(0.0, 60.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_new_origin_leaves_the_course_as_it_was(
    shift_s: float, first: float, second: float
) -> None:
    one = branch()
    one.theta[3:5] = [first, second]
    before = rls.covariance(one.upper, one.diagonal)
    restart_past(one, LEARNING, MOTOR, shift_s)
    for later_s in (0.0, 3.0, 20.0):
        h, old = later_s / TAU_S, (later_s + shift_s) / TAU_S
        expected = (first + second * old) * math.exp(-old)
        assert (one.theta[3] + one.theta[4] * h) * math.exp(-h) == pytest.approx(
            expected, abs=1e-12
        )
    assert one.origin_s == shift_s
    after = rls.covariance(one.upper, one.diagonal)
    assert after[0] == pytest.approx(before[0])


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=16, max_size=16),
    st.lists(st.floats(0.01, 9.0), min_size=4, max_size=4),
)
def test_a_transformed_covariance_is_that_of_numpy(
    entries: list[float], diagonal: list[float]
) -> None:
    matrix = np.array(entries).reshape(4, 4) + 4.5 * np.eye(4)  # loses no direction
    upper = np.triu(np.ones((4, 4)) * 0.3, 1) + np.eye(4)
    expected = matrix @ upper @ np.diag(diagonal) @ upper.T @ matrix.T
    factors, weights = upper.ravel().tolist(), list(diagonal)
    rls.transform(factors, weights, matrix.ravel().tolist())
    found = np.array(rls.covariance(factors, weights)).reshape(4, 4)
    np.testing.assert_allclose(found, expected, atol=1e-9 * max(1.0, np.abs(expected).max()))
    assert min(weights) > 0.0


def test_directional_forgetting_forgets_only_along_the_sample() -> None:
    """Information afterwards: Λ - (1 - ρ)/(rᵀPr) r rᵀ + r rᵀ."""
    random = np.random.default_rng(3)
    upper = np.triu(random.normal(size=(3, 3)), 1) + np.eye(3)
    diagonal, r = [2.0, 0.5, 3.0], random.normal(size=3)
    before = upper @ np.diag(diagonal) @ upper.T
    information = np.linalg.inv(before)
    information += (1.0 - (1.0 - 0.97) / (r @ before @ r)) * np.outer(r, r)
    factors, weights, parameters = upper.ravel().tolist(), list(diagonal), [0.1, 0.2, 0.3]
    rls.update_along(parameters, factors, weights, r.tolist(), 1.5, 0.97)
    found = np.array(rls.covariance(factors, weights)).reshape(3, 3)
    np.testing.assert_allclose(np.linalg.inv(found), information, rtol=1e-9)
    gain = found @ r
    expected = np.array([0.1, 0.2, 0.3]) + gain * (1.5 - r @ [0.1, 0.2, 0.3])
    np.testing.assert_allclose(parameters, expected, rtol=1e-9)
