"""Batch least squares against numpy and scipy, and the identification of what scipy simulates."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import hilbert
from scipy.signal import lfilter

from adaptdrive.control import rls
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.batch import Record, Structure, identify, least_squares
from tests.control.systems import Array, System, held_polynomials, motor_system, stable_systems

TRUTH = np.array([1.0, -0.5, 2.0])


def noisy_data(seed: int, count: int = 200, sigma: float = 0.1) -> tuple[Array, Array]:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(count, 3))
    return rows, rows @ TRUTH + sigma * random.normal(size=count)


def test_it_is_the_least_squares_of_numpy() -> None:
    rows, targets = noisy_data(1)
    expected, squares, rank, _ = np.linalg.lstsq(rows, targets)
    fit = least_squares(rows, targets)
    assert fit.theta == pytest.approx(expected, rel=1e-12)
    assert fit.sigma == pytest.approx(math.sqrt(squares[0] / 197), rel=1e-12)
    assert fit.rank == rank
    expected_covariance = fit.sigma**2 * np.linalg.inv(rows.T @ rows)
    assert fit.covariance == pytest.approx(expected_covariance, rel=1e-10, abs=1e-15)


def test_the_covariance_is_what_many_experiments_show() -> None:
    rows, _ = noisy_data(1, 50)
    random = np.random.default_rng(2)
    fits = [least_squares(rows, rows @ TRUTH + 0.1 * random.normal(size=50)) for _ in range(600)]
    claimed = np.mean([fit.deviations for fit in fits], axis=0)
    assert claimed == pytest.approx(np.std([fit.theta for fit in fits], axis=0), rel=0.1)


def test_it_solves_what_the_normal_equations_cannot() -> None:
    rows = hilbert(12)[:, :8]  # condition 1e10 or so: squared, nothing is left
    truth = np.ones(8)
    targets = rows @ truth
    fit = least_squares(rows, targets)
    assert fit.theta == pytest.approx(truth, abs=1e-4)
    assert fit.condition > 1e8
    try:
        normal = np.linalg.solve(rows.T @ rows, rows.T @ targets)
    except np.linalg.LinAlgError:
        return  # on some processors they come out singular
    assert np.abs(normal - truth).max() > 1000 * np.abs(fit.theta - truth).max()


def test_units_do_not_matter() -> None:
    rows, targets = noisy_data(3)
    units = np.array([1e-9, 1.0, 1e9])
    fit, other = least_squares(rows, targets), least_squares(rows * units, targets)
    assert other.theta * units == pytest.approx(fit.theta, rel=1e-12)
    assert other.condition == pytest.approx(fit.condition, rel=1e-9)


def test_what_the_data_leave_open_is_said() -> None:
    rows, targets = noisy_data(4)
    rows[:, 2] = rows[:, 0] + rows[:, 1]
    fit = least_squares(rows, targets)
    assert fit.rank == 2
    assert np.isnan(fit.covariance).all()
    residual = np.linalg.norm(targets - rows @ fit.theta)
    expected = np.linalg.lstsq(rows, targets)[0]
    assert residual == pytest.approx(np.linalg.norm(targets - rows @ expected), rel=1e-9)


def test_few_samples_have_no_sigma() -> None:
    rows, targets = noisy_data(5, 3)
    assert math.isnan(least_squares(rows, targets).sigma)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_not_a_number_is_refused(bad: float) -> None:
    rows, targets = noisy_data(6)
    rows[7, 1] = bad
    with pytest.raises(ValueError, match="finite"):
        least_squares(rows, targets)


@pytest.mark.parametrize("covariance", [1e-2, 1.0, 1e4])
def test_with_a_start_it_is_recursive_least_squares_without_forgetting(covariance: float) -> None:
    rows, targets = noisy_data(7, 60)
    theta, upper, diagonal = [0.0] * 3, [0.0] * 9, [0.0] * 3
    rls.reset(theta, upper, diagonal, covariance)
    for row, target in zip(rows, targets, strict=True):
        rls.update(theta, upper, diagonal, row.tolist(), float(target), 1.0)
    fit = least_squares(rows, targets, initial_covariance=covariance * np.eye(3))
    assert np.array(theta) == pytest.approx(fit.theta, rel=1e-9)
    p = np.array(ud.covariance(upper, diagonal)).reshape(3, 3)
    assert fit.sigma**2 * p == pytest.approx(fit.covariance, rel=1e-9, abs=1e-18)


def test_a_confident_start_is_kept() -> None:
    rows, targets = noisy_data(8, 20)
    start = np.array([3.0, 3.0, 3.0])
    fit = least_squares(rows, targets, initial_covariance=1e-9 * np.eye(3), initial_theta=start)
    assert fit.theta == pytest.approx(start, abs=1e-4)


def record_of(
    system: System, count: int, period_s: float, *, offset: float = 0.0, noise: float = 0.0
) -> Record:
    """A record whose input changes now and then, from rest at zero."""
    random = np.random.default_rng(9)
    inputs = np.repeat(random.choice([-1.0, 1.0], count // 10 + 1), 10)[:count]
    inputs[:2] = 0.0
    a, b = held_polynomials(system, period_s)
    outputs = offset + lfilter(b, a, inputs) + noise * random.normal(size=count)
    return Record(outputs.tolist(), inputs.tolist(), period_s)


RESONANT = System([1.0, 0.0, 0.0, 1.778e-4], [1.0, 0.08435, 0.004743, 1.778e-4])
"""Each jump of its input passes at once; at 0.05 rad/s next to nothing passes."""


@settings(max_examples=15, deadline=None)
@given(stable_systems((1, 3), direct=True), st.booleans())
@example(RESONANT, True)
def test_any_order_with_direct_term_and_constant_is_found(system: System, at_rest: bool) -> None:
    record = record_of(system, 2500, 0.05, offset=0.7)
    found = identify(record, Structure(system.order, direct=True, bias=True, at_rest=at_rest), 4.0)
    for rad_s in (0.0, 0.05, 0.3, 1.0):
        point = 1j * rad_s
        response = np.polyval(found.numerator, point) / np.polyval(found.denominator, point)
        assert abs(response - system.response(rad_s)) < 5e-3 * (1.0 + abs(system.response(rad_s)))


def test_what_jumps_with_the_input_is_no_ramp_between_two_samples() -> None:
    record = record_of(RESONANT, 2500, 0.05, offset=0.7)
    found = identify(record, Structure(3, direct=True, bias=True), 4.0)
    assert found.numerator[0] == pytest.approx(1.0, abs=1e-5)
    point = 0.05j
    response = np.polyval(found.numerator, point) / np.polyval(found.denominator, point)
    assert abs(response - RESONANT.response(0.05)) < 1e-3


def test_a_motor_is_found_with_honest_error_bars() -> None:
    system = motor_system(2)
    record = record_of(system, 6000, 0.1, noise=1e-5)
    found = identify(record, Structure(2, at_rest=True), 10.0)
    assert found.numerator[0] == 0.0
    assert found.denominator == pytest.approx(system.denominator, rel=0.01)
    assert found.numerator[2] == pytest.approx(system.numerator[2], rel=0.01)
    deviations = np.sqrt(np.diag(found.covariance))
    assert deviations[0] == 0.0
    errors = np.concatenate([found.numerator, found.denominator[1:]]) - np.concatenate(
        [system.numerator, system.denominator[1:]]
    )
    assert (np.abs(errors[1:]) < 5.0 * deviations[1:] + 1e-6).all()


def test_a_record_that_begins_in_the_middle_is_no_worse() -> None:
    system, whole = motor_system(1), record_of(motor_system(1), 6000, 0.1)
    cut = Record(whole.outputs[2345:], whole.inputs[2345:], 0.1)
    found = identify(cut, Structure(2), 10.0)
    assert found.denominator == pytest.approx(system.denominator, rel=2e-3)
    careless = identify(cut, Structure(2, at_rest=True), 10.0)
    assert abs(careless.denominator[2] / system.denominator[2] - 1.0) > 0.02


def test_a_series_of_two_lengths_is_refused() -> None:
    with pytest.raises(ValueError, match="3 outputs, but 2 inputs"):
        identify(Record([1.0, 2.0, 3.0], [1.0, 2.0], 0.1), Structure(1), 1.0)
