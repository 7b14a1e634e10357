"""Poles that keep the noise of the output out of the input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from adaptdrive.control.design import asked_loop, discrete_model, loop_gains
from adaptdrive.control.noise_limit import (
    OBSERVER_POLE,
    SLOWEST_SHARE,
    impulse_norm,
    noise_gain,
    quiet_loop,
    slowed_loop,
)
from adaptdrive.control.pole_placement import desired_polynomial, equation
from tests.closed_loop.bench import EXACT, MOTOR
from tests.control.systems import distance, motor_system

POLE = 0.7
roots = st.lists(st.floats(-0.95, 0.95), min_size=1, max_size=6)


def model(disks: int) -> tuple[list[float], list[float]]:
    system = motor_system(disks)
    return discrete_model(EXACT, MOTOR, system.numerator, system.denominator, 1.0)


def input_of_a_noisy_loop(a: list[float], b: list[float], gains: list[float]) -> float:
    """Standard deviation of u in a loop whose output is measured with a noise of 1."""
    taps, noise = len(b) - 1, np.random.default_rng(3).normal(size=100_000)
    u, y = np.zeros(len(noise) + taps), np.zeros(len(noise) + taps)
    seen = np.zeros(len(noise) + taps)
    for k in range(taps, len(noise)):
        past = u[k - taps : k][::-1]
        y[k] = np.dot(b[1:], past) - np.dot(a[1:], y[k - len(a) + 1 : k][::-1])
        seen[k] = y[k] + noise[k]
        u[k] = -np.dot(gains[:taps], past) - np.dot(
            gains[taps:], seen[k - len(a) + 1 : k + 1][::-1]
        )
    return float(np.std(u))


@given(roots, st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=6))
def test_the_norm_is_that_of_the_impulse_response(poles: list[float], b: list[float]) -> None:
    denominator = [float(x) for x in np.poly(poles)]
    numerator = b[: len(denominator)]
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    expected = np.linalg.norm(lfilter(numerator, denominator, impulse))
    assert impulse_norm(numerator, denominator) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_the_gain_is_what_a_noisy_loop_shows() -> None:
    a, b = model(3)
    loop = asked_loop(b, MOTOR.order, POLE)
    expected = input_of_a_noisy_loop(a, b, loop_gains(equation(a, b), a, b, loop))
    assert noise_gain(equation(a, b), a, b, loop) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("count", [4, 6, 9])
def test_a_norm_that_rounding_hides_is_not_taken_for_a_small_one(count: int) -> None:
    assert impulse_norm([1.0], desired_polynomial(0.9999, count)) > 1e4


@pytest.mark.parametrize("noise", [1e-4, 0.01, 1.0, 100.0])
def test_poles_close_to_one_give_a_loop_at_any_noise(noise: float) -> None:
    a, b = model(3)
    found = np.roots(quiet_loop(equation(a, b), a, b, MOTOR.order, 0.999, noise, 15.0))
    assert np.all(np.isfinite(found))


@pytest.mark.parametrize(("noise", "limit"), [(1e-4, 15.0), (0.0, 15.0), (1.0, 0.0)])
def test_poles_are_as_asked_while_the_noise_is_within_its_limit(noise: float, limit: float) -> None:
    a, b = model(3)
    found = np.roots(quiet_loop(equation(a, b), a, b, MOTOR.order, POLE, noise, limit))
    assert distance(found, [POLE] * 4 + [0.0] * (len(found) - 4)) < 2e-3


@pytest.mark.parametrize("disks", [1, 3])
@pytest.mark.parametrize("times", [1.2, 3.0, 10.0])
def test_the_noise_of_the_input_is_just_within_its_limit(disks: int, times: float) -> None:
    a, b = model(disks)
    limit = noise_gain(equation(a, b), a, b, asked_loop(b, MOTOR.order, POLE)) / times
    found = noise_gain(
        equation(a, b), a, b, quiet_loop(equation(a, b), a, b, MOTOR.order, POLE, 1.0, limit)
    )
    assert 0.8 * limit <= found <= limit


@pytest.mark.parametrize(
    ("tau_motor_s", "tau_filter_s", "pole"),
    [(11.7, 2.0, 0.93), (5.0, 1.0, 0.9), (11.7, 10.0, 0.93), (35.1, 10.0, 0.97), (0.5, 0.3, 0.98)],
)
@pytest.mark.parametrize("times", [1.01, 1.05, 3.0, 1000.0])
def test_a_limit_makes_no_loop_louder_than_the_poles_asked_for(
    tau_motor_s: float, tau_filter_s: float, pole: float, times: float
) -> None:
    """Poles slower than the load's own take gains that pass more noise, not less."""
    values = [0.011, tau_motor_s + tau_filter_s, tau_motor_s * tau_filter_s]
    a, b = discrete_model(EXACT, MOTOR, *MOTOR.realise(values), 1.0)
    asked = noise_gain(equation(a, b), a, b, asked_loop(b, MOTOR.order, pole))
    found = noise_gain(
        equation(a, b),
        a,
        b,
        quiet_loop(equation(a, b), a, b, MOTOR.order, pole, 1.0, asked / times),
    )
    assert found <= asked * (1.0 + 1e-9)


def test_observer_poles_come_first() -> None:
    a, b = model(3)
    asked = noise_gain(equation(a, b), a, b, asked_loop(b, MOTOR.order, POLE))
    found = np.roots(quiet_loop(equation(a, b), a, b, MOTOR.order, POLE, 1.0, asked / 2.0))
    assert np.sort(np.abs(found))[1:] == pytest.approx([POLE] * 4, abs=2e-3)
    slowness = float(np.min(np.abs(found))) / 0.8
    assert 0.3 < slowness < 1.0
    free = len(found) - 2 * MOTOR.order
    for faster, within in ((0.0, True), (0.041, False)):
        loop = slowed_loop([1.0], MOTOR.order, free, POLE, slowness - faster)
        assert (noise_gain(equation(a, b), a, b, loop) <= asked / 2.0) is within


@pytest.mark.parametrize("noise", [1e3, np.inf, np.nan])
def test_no_noise_makes_the_poles_slower_than_a_quarter_of_the_asked_speed(noise: float) -> None:
    a, b = model(1)
    found = np.roots(quiet_loop(equation(a, b), a, b, MOTOR.order, POLE, noise, 1.0))
    slowest = 1.0 - SLOWEST_SHARE * (1.0 - POLE)
    assert distance(found, [slowest] * 4 + [OBSERVER_POLE] * (len(found) - 4)) < 5e-3


def test_a_zero_that_is_cancelled_stays_a_pole_of_the_loop() -> None:
    a, b = [1.0, -0.9565], [0.0, 0.208, -0.208 * 0.9674]
    found = np.roots(quiet_loop(equation(a, b), a, b, 1, POLE, 1.0, 1.0))
    assert np.min(np.abs(found - 0.9674)) < 1e-9
    assert np.max(np.abs(found)) == pytest.approx(0.9674, abs=1e-9)
