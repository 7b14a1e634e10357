"""Feedback that is faster than the response asked for: limits of noise, margins, and its use."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.design import asked_loop, discrete_model, loop_gains
from adaptdrive.control.fast_feedback import (
    DELAY_MARGIN,
    MODULUS_MARGIN,
    SPENT,
    fast_loop,
    has_margins,
    unit_circle,
)
from adaptdrive.control.noise_limit import noise_gain
from adaptdrive.control.pole_placement import desired_polynomial, equation, place_poles
from adaptdrive.control.vectors import multiply
from tests.closed_loop.bench import EXACT, MOTOR
from tests.control.systems import motor_system

POLE = 0.7


def model(disks: int) -> tuple[list[float], list[float]]:
    system = motor_system(disks)
    return discrete_model(EXACT, MOTOR, system.numerator, system.denominator, 1.0)


def made(disks: int, noise: float, limit: float = 8.0, pole: float = POLE) -> list[float]:
    a, b = model(disks)
    return faster((a, b), pole, noise, limit)


def faster(
    model: tuple[list[float], list[float]], pole: float, noise: float, limit: float
) -> list[float]:
    (a, b), order = model, len(model[0]) - 1
    quiet, circle = asked_loop(b, order, pole), unit_circle(len(a) + len(b) - 1)
    return fast_loop(equation(a, b), a, b, order, pole, quiet, noise, limit, circle)


def values(polynomial: list[float], angles: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.polyval(polynomial[::-1], np.exp(-1j * angles))
    return found


def open_loop(a: list[float], b: list[float], loop: list[float], angles: np.ndarray) -> np.ndarray:
    r, s = place_poles(a, b, loop)
    forward = values(a, angles) * values(r, angles)
    found: np.ndarray = values(b, angles) * values(s, angles) / forward
    return found


def largest_root(*terms: list[float]) -> float:
    size = max(map(len, terms))
    closed = np.sum([np.pad(term, (0, size - len(term))) for term in terms], axis=0)
    return float(np.max(np.abs(np.roots(closed))))


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_without_noise_the_margins_are_used_and_kept(disks: int) -> None:
    """The distance of L from -1 is just above its limit on a dense grid of frequencies."""
    a, b = model(disks)
    angles = np.geomspace(1e-3, np.pi, 20_000)
    distance = np.min(np.abs(1.0 + open_loop(a, b, made(disks, 0.0), angles)))
    assert 0.99 * MODULUS_MARGIN < distance < 1.06 * MODULUS_MARGIN


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_loop_stands_another_gain_and_another_delay(disks: int) -> None:
    a, b = model(disks)
    loop = made(disks, 0.0)
    r, s = place_poles(a, b, loop)
    for gain in (0.5, 1.0 / (1.0 - MODULUS_MARGIN)):
        assert largest_root(multiply(a, r), [gain * x for x in multiply(b, s)]) < 1.0
    tick = EXACT.rates.ticks_per_period
    later = EXACT.rates.__class__(
        ticks_per_period=tick,
        latency_ticks=EXACT.rates.latency_ticks + round(DELAY_MARGIN * tick),
        samples=EXACT.rates.samples,
        nominal_tick_s=EXACT.rates.nominal_tick_s,
    )
    system = motor_system(disks)
    settings = EXACT.__class__(EXACT.exact, EXACT.stage, later, EXACT.learning, EXACT.jacket)
    late_a, late_b = discrete_model(settings, MOTOR, system.numerator, system.denominator, 1.0)
    assert largest_root(multiply(late_a, r), multiply(late_b, s)) < 1.0


def test_margins_are_those_of_the_open_loop() -> None:
    a, b = model(1)
    angles = np.geomspace(1e-3, np.pi, 20_000)
    for pole in np.arange(0.30, 0.70, 0.04):
        loop = desired_polynomial(pole, 4)
        distance = float(np.min(np.abs(1.0 + open_loop(a, b, loop, angles))))
        if abs(distance - MODULUS_MARGIN) > 0.02:
            circle = unit_circle(len(a) + len(b) - 1)
            r, s = place_poles(a, b, loop)
            found = has_margins(multiply(a, r), multiply(b, s), loop, circle)
            assert found is (distance > MODULUS_MARGIN)


@pytest.mark.parametrize("noise", [1.5e-4, 2e-4, 3e-4])
def test_noise_is_spent_up_to_a_share_of_its_limit(noise: float) -> None:
    a, b = model(1)
    found = noise * noise_gain(equation(a, b), a, b, made(1, noise))
    assert 0.85 * SPENT * 8.0 < found <= SPENT * 8.0


@pytest.mark.parametrize(("noise", "limit"), [(1e-3, 8.0), (0.0, 0.0), (np.nan, 8.0)])
def test_where_noise_leaves_no_room_the_quiet_loop_stays(noise: float, limit: float) -> None:
    _, b = model(1)
    assert made(1, noise, limit) == asked_loop(b, MOTOR.order, POLE)


@pytest.mark.parametrize("disks", [1, 3])
def test_a_disturbance_moves_the_output_half_as_far_and_is_gone_sooner(disks: int) -> None:
    a, b = model(disks)
    quiet, fast = (
        response_to_a_disturbance(a, b, loop)
        for loop in (asked_loop(b, MOTOR.order, POLE), made(disks, 0.0))
    )
    assert np.max(np.abs(fast)) < 0.53 * np.max(np.abs(quiet))
    assert np.sqrt(np.mean(fast**2)) < 0.43 * np.sqrt(np.mean(quiet**2))
    assert abs(fast[-1]) < 1e-9


def response_to_a_disturbance(a: list[float], b: list[float], loop: list[float]) -> np.ndarray:
    """Output after a step of the input's offset, by the difference equations of load and law."""
    gains, taps = loop_gains(equation(a, b), a, b, loop), len(b) - 1
    u, y = np.zeros(100), np.zeros(100)
    for k in range(10, 100):
        y[k] = np.dot(b[1:], u[k - 1 : k - taps - 1 : -1] + 1.0) - np.dot(
            a[1:], y[k - 1 : k - len(a) : -1]
        )
        u[k] = -np.dot(gains[:taps], u[k - 1 : k - taps - 1 : -1]) - np.dot(
            gains[taps:], y[k : k - len(a) : -1]
        )
    return y[10:]


@pytest.mark.parametrize("pole", [0.3, 0.8, 0.93])
def test_the_loop_is_never_slower_than_asked(pole: float) -> None:
    a, b = model(1)
    found = faster((a, b), pole, 0.0, 8.0)
    assert np.max(np.abs(np.roots(found))) <= pole + 2e-3
