"""What a change leaves in the λ filters, against scipy; and the algebra of P, against numpy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lsim

from adaptdrive.control import rls
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.branch import (
    Branch,
    Datum,
    count_prediction,
    predict_sample,
)
from adaptdrive.control.hypotheses import (
    ANEW,
    BOTH,
    DISTURBANCE,
    LOAD,
    NOTHING,
    Anchor,
    load_direction,
    restart_past,
    widen,
)
from adaptdrive.control.load import Load
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.regression import theta_of
from adaptdrive.control.settings import Learning
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LEARNING = replace(SCALED_LEARNING, bias=True, alert=True, initial_state=True)
STEP_S, TAU_S = 0.01, 10.0
CHANGE = 6000
"""Datum of the change."""


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
    return math.sqrt(ud.excitation(one.upper, one.diagonal, direction.tolist()))


CHARGING = replace(LEARNING, charge=True)
BATTERY = battery_load(0.25, 1.2, 0.4, 30.0)


def moves(kind: int, learning: Learning, load: Load, values: Array) -> list[Array]:
    """What a kind of change may make of α, β, charge and bias, times its deviation: dense."""
    alpha, beta = load.order, len(load.input_powers)
    last, acting = alpha + beta - 1, np.zeros(len(values))
    acting[alpha : alpha + beta] = 1.0
    beside = np.zeros(len(values))
    beside[-1], beside[-2] = learning.bias, learning.charge
    total, found = float(values @ acting), []
    if kind in (DISTURBANCE, BOTH, ANEW) and learning.bias:
        found.append(0.1 * abs(total) * np.eye(len(values))[-1])
    for i in range(last) if kind in (LOAD, BOTH, ANEW) else ():
        other = values.copy()  # with the same dc gain, and the same offset of the input
        other[i] += 1.0
        below, below_then = 1.0 + sum(values[:alpha]), 1.0 + sum(other[:alpha])
        other[last] += total / below * below_then - other @ acting
        found.append(0.5 * (other + values * beside * (other @ acting / total - 1.0) - values))
    if kind in (BOTH, ANEW):
        found.append(0.5 * values * (acting + beside))
    return found


def widened(kind: int, learning: Learning, load: Load, values: Array, at: Anchor) -> Array:
    """P after widening, by sums of outer products, of P = 1e-6 I."""
    size, first = len(values), load.order + len(load.input_powers)
    covariance = 1e-6 * np.eye(size)
    for step in moves(kind, learning, load, values):
        step[first] = -np.dot(at.regressor, step)
        if load.order > 1:
            step[first + 1] = -np.dot(at.lowered, step * (np.arange(size) != first))
        covariance += np.outer(step, step) / at.power
    blurred = 0.1 * abs(sum(values[load.order : first])) * at.gap_s / TAU_S
    doubts = {NOTHING: 0.0, ANEW: blurred**2 + 0.25}.get(kind, blurred**2)
    for i in range(first, first + load.order):
        covariance[i, i] += doubts / at.power
    return covariance


@pytest.mark.parametrize("kind", [NOTHING, DISTURBANCE, LOAD, BOTH, ANEW])
@pytest.mark.parametrize(
    ("load", "learning"),
    [(MOTOR, LEARNING), (MOTOR, replace(LEARNING, bias=False)), (BATTERY, CHARGING)],
)
def test_the_covariance_is_widened_by_what_may_have_moved(
    load: Load, learning: Learning, kind: int
) -> None:
    random = np.random.default_rng(kind)
    physical = theta_of(learning, load, list(load.numerator), list(load.denominator))
    beside = [0.03, -0.2][2 - learning.bias - learning.charge :]
    values = np.array([*physical, *[0.0] * load.order, *beside])
    size, first = len(values), load.order + len(load.input_powers)
    plain, lowered = random.normal(size=(2, size))
    for row in (plain, lowered):
        row[first : first + load.order] = 0.0  # as the functions of the initial state are filled
    at = Anchor(plain.tolist(), lowered.tolist(), power=1e-4, gap_s=2.0)
    one = Branch(values.tolist(), np.eye(size).ravel().tolist(), [1e-6] * size)
    widen(one, kind, learning, load, at)
    found = np.array(ud.covariance(one.upper, one.diagonal)).reshape(size, size)
    expected = widened(kind, learning, load, values, at)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_a_prediction_is_judged_by_its_error_and_by_what_it_was_unsure_of() -> None:
    """ε² ρ/(ρ + rᵀPr) and ln(1 + rᵀPr/ρ), with the functions of the state at the start in r."""
    one, forgetting = branch(variance=0.25), 0.97
    one.origin_s = 4.0
    r = np.array([-0.9, -0.8, 0.7, 9.0, 9.0, 1.0])
    filled = np.array([*r[:3], math.exp(-0.3), 0.3 * math.exp(-0.3), 1.0])
    error, excitation = 0.5 - filled @ one.theta, 0.25 * float(filled @ filled)
    for count in (1, 2):
        predict_sample(one, LEARNING, MOTOR, Datum(r.tolist(), 0.5, 7.0))
        count_prediction(one, forgetting)
        weight = forgetting / (forgetting + excitation)
        assert one.squares == pytest.approx(count * error**2 * weight)
        assert one.logs == pytest.approx(-count * math.log(weight))


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
    before = ud.covariance(one.upper, one.diagonal)
    restart_past(one, LEARNING, MOTOR, shift_s)
    for later_s in (0.0, 3.0, 20.0):
        h, old = later_s / TAU_S, (later_s + shift_s) / TAU_S
        expected = (first + second * old) * math.exp(-old)
        assert (one.theta[3] + one.theta[4] * h) * math.exp(-h) == pytest.approx(
            expected, abs=1e-12
        )
    assert one.origin_s == shift_s
    after = ud.covariance(one.upper, one.diagonal)
    assert after[0] == pytest.approx(before[0])


@pytest.mark.parametrize("shift_s", [0.0, 2.0, 15.0])
def test_the_covariance_follows_a_new_origin(shift_s: float) -> None:
    """By the matrix that takes γ to γ': both give the same course at two times."""
    one = branch(variance=2.0)
    restart_past(one, LEARNING, MOTOR, shift_s)
    h = np.array([[0.2], [0.9]])
    new, old = (np.hstack([np.exp(-t), t * np.exp(-t)]) for t in (h, h + shift_s / TAU_S))
    matrix = np.linalg.solve(new, old)
    found = np.array(ud.covariance(one.upper, one.diagonal)).reshape(6, 6)[3:5, 3:5]
    np.testing.assert_allclose(found, 2.0 * matrix @ matrix.T, rtol=1e-9, atol=1e-15)


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
    ud.transform(factors, weights, matrix.ravel().tolist())
    found = np.array(ud.covariance(factors, weights)).reshape(4, 4)
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
    found = np.array(ud.covariance(factors, weights)).reshape(3, 3)
    np.testing.assert_allclose(np.linalg.inv(found), information, rtol=1e-9)
    gain = found @ r
    expected = np.array([0.1, 0.2, 0.3]) + gain * (1.5 - r @ [0.1, 0.2, 0.3])
    np.testing.assert_allclose(parameters, expected, rtol=1e-9)


def test_no_offset_is_carried_by_a_load_without_a_gain_at_rest() -> None:
    """1 + Σα = 0: an integrator, whose input has no offset that a constant output shows."""
    values = [-0.4, -0.6, 0.3, 0.0, 0.0, 0.2]
    assert load_direction(values, 0, LEARNING, MOTOR) == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
