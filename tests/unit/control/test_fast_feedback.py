"""Poles of the loop beside the response asked for: faster, quieter, and the filter between."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from adaptdrive.control.design.noise import (
    DELAY_MARGIN,
    MODULUS_MARGIN,
    OBSERVER_POLE,
    SLOWEST_SHARE,
    SPENT,
    detuned_loop,
    fast_loop,
    has_margins,
    impulse_norm,
    noise_gain,
    slowed_loop,
)
from adaptdrive.control.design.pole_placement import (
    Plant,
    desired_polynomial,
    discrete_model,
)
from adaptdrive.control.design.reference import (
    ReferenceFilter,
    condition_reference,
    filter_reference,
)
from adaptdrive.control.slow import control_law
from adaptdrive.control.vectors import copy_into, multiply
from tests.integration.closed_loop.bench import EXACT, MOTOR
from tests.unit.control.systems import Array, distance, motor_system

POLE = 0.7


def motor(disks: int) -> Plant:
    system = motor_system(disks)
    return Plant(*discrete_model(EXACT, MOTOR, system.numerator, system.denominator, 1.0))


def made(plant: Plant, noise: float, limit: float = 8.0, pole: float = POLE) -> list[float]:
    """A_f beside the quiet loop that is asked for."""
    return fast_loop(plant, pole, plant.asked(pole), noise, limit)


def values(polynomial: list[float], angles: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.polyval(polynomial[::-1], np.exp(-1j * angles))
    return found


def open_loop(plant: Plant, loop: list[float], angles: np.ndarray) -> np.ndarray:
    r, s = plant.place(loop)
    forward = values(plant.a, angles) * values(r, angles)
    found: np.ndarray = values(plant.b, angles) * values(s, angles) / forward
    return found


def largest_root(*terms: list[float]) -> float:
    size = max(map(len, terms))
    closed = np.sum([np.pad(term, (0, size - len(term))) for term in terms], axis=0)
    return float(np.max(np.abs(np.roots(closed))))


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_without_noise_the_margins_are_used_and_kept(disks: int) -> None:
    """The distance of L from -1 is just above its limit on a dense quantiser of frequencies."""
    plant = motor(disks)
    angles = np.geomspace(1e-3, np.pi, 20_000)
    distance = np.min(np.abs(1.0 + open_loop(plant, made(plant, 0.0), angles)))
    assert 0.99 * MODULUS_MARGIN < distance < 1.06 * MODULUS_MARGIN


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_the_loop_stands_another_gain_and_another_delay(disks: int) -> None:
    plant = motor(disks)
    r, s = plant.place(made(plant, 0.0))
    for gain in (0.5, 1.0 / (1.0 - MODULUS_MARGIN)):
        back = [gain * x for x in multiply(plant.b, s)]
        assert largest_root(multiply(plant.a, r), back) < 1.0
    tick = EXACT.rates.ticks_per_period
    later = EXACT.rates.__class__(
        ticks_per_period=tick,
        latency_ticks=EXACT.rates.latency_ticks + round(DELAY_MARGIN * tick),
        samples=EXACT.rates.samples,
        nominal_tick_s=EXACT.rates.nominal_tick_s,
        lag_ticks=EXACT.rates.lag_ticks,
    )
    system = motor_system(disks)
    settings = EXACT.__class__(EXACT.exact, EXACT.stage, later, EXACT.learning, EXACT.supervision)
    late_a, late_b = discrete_model(settings, MOTOR, system.numerator, system.denominator, 1.0)
    assert largest_root(multiply(late_a, r), multiply(late_b, s)) < 1.0


def test_margins_are_those_of_the_open_loop() -> None:
    plant = motor(1)
    angles = np.geomspace(1e-3, np.pi, 20_000)
    for pole in np.arange(0.30, 0.70, 0.04):
        loop = [*desired_polynomial(pole, 4), *[0.0] * plant.free]
        distance = float(np.min(np.abs(1.0 + open_loop(plant, loop, angles))))
        if abs(distance - MODULUS_MARGIN) > 0.02:
            assert has_margins(plant, loop) is (distance > MODULUS_MARGIN)


@pytest.mark.parametrize("noise", [1.5e-4, 2e-4, 3e-4])
def test_noise_is_spent_up_to_a_share_of_its_limit(noise: float) -> None:
    plant = motor(1)
    found = noise * noise_gain(plant, made(plant, noise))
    assert 0.85 * SPENT * 8.0 < found <= SPENT * 8.0


@pytest.mark.parametrize(("noise", "limit"), [(1e-3, 8.0), (0.0, 0.0), (np.nan, 8.0)])
def test_where_noise_leaves_no_room_the_quiet_loop_stays(noise: float, limit: float) -> None:
    plant = motor(1)
    assert made(plant, noise, limit) == plant.asked(POLE)


@pytest.mark.parametrize("disks", [1, 3])
def test_a_disturbance_moves_the_output_half_as_far_and_is_gone_sooner(disks: int) -> None:
    plant = motor(disks)
    quiet, fast = (
        closed(plant, loop, np.ones(100), np.zeros(100))[1]
        for loop in (plant.asked(POLE), made(plant, 0.0))
    )
    assert np.max(np.abs(fast)) < 0.53 * np.max(np.abs(quiet))
    assert np.sqrt(np.mean(fast**2)) < 0.43 * np.sqrt(np.mean(quiet**2))
    assert abs(fast[-1]) < 1e-9


def closed(plant: Plant, loop: list[float], offset: Array, noise: Array) -> tuple[Array, Array]:
    """Input and output by the difference equations of load and law, with what disturbs them."""
    a, b = plant.a, plant.b
    gains, taps = np.array(plant.gains(loop)), len(b) - 1
    u, y, seen = np.zeros((3, len(offset)))
    for k in range(taps, len(offset)):
        past = u[k - taps : k][::-1]
        y[k] = np.dot(b[1:], past + offset[k]) - np.dot(a[1:], y[k - len(a) + 1 : k][::-1])
        seen[k] = y[k] + noise[k]
        u[k] = -gains[:taps] @ past - gains[taps:] @ seen[k - len(a) + 1 : k + 1][::-1]
    return u, y


@pytest.mark.parametrize("pole", [0.3, 0.8, 0.93])
def test_the_loop_is_never_slower_than_asked(pole: float) -> None:
    found = made(motor(1), 0.0, pole=pole)
    assert np.max(np.abs(np.roots(found))) <= pole + 2e-3


roots = st.lists(st.floats(-0.95, 0.95), min_size=1, max_size=6)


@given(roots, st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=6))
def test_the_norm_is_that_of_the_impulse_response(poles: list[float], b: list[float]) -> None:
    denominator = [float(x) for x in np.poly(poles)]
    numerator = b[: len(denominator)]
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    expected = np.linalg.norm(lfilter(numerator, denominator, impulse))
    assert impulse_norm(numerator, denominator) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_the_gain_is_what_a_noisy_loop_shows() -> None:
    plant, noise = motor(3), np.random.default_rng(3).normal(size=100_000)
    loop = plant.asked(POLE)
    u, _ = closed(plant, loop, np.zeros(len(noise)), noise)
    assert noise_gain(plant, loop) == pytest.approx(float(np.std(u)), rel=0.02)


@pytest.mark.parametrize(("noise", "limit"), [(1e-4, 15.0), (0.0, 15.0), (1.0, 0.0)])
def test_poles_are_as_asked_while_the_noise_is_within_its_limit(noise: float, limit: float) -> None:
    found = np.roots(detuned_loop(motor(3), POLE, noise, limit))
    assert distance(found, [POLE] * 4 + [0.0] * (len(found) - 4)) < 2e-3


@pytest.mark.parametrize("disks", [1, 3])
@pytest.mark.parametrize("times", [1.2, 3.0, 10.0])
def test_the_noise_of_the_input_is_just_within_its_limit(disks: int, times: float) -> None:
    plant = motor(disks)
    limit = noise_gain(plant, plant.asked(POLE)) / times
    found = noise_gain(plant, detuned_loop(plant, POLE, 1.0, limit))
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
    plant = Plant(*discrete_model(EXACT, MOTOR, *MOTOR.realise(values), 1.0))
    asked = noise_gain(plant, plant.asked(pole))
    found = noise_gain(plant, detuned_loop(plant, pole, 1.0, asked / times))
    assert found <= asked * (1.0 + 1e-9)


def test_observer_poles_come_first() -> None:
    plant = motor(3)
    asked = noise_gain(plant, plant.asked(POLE))
    found = np.roots(detuned_loop(plant, POLE, 1.0, asked / 2.0))
    assert np.sort(np.abs(found))[1:] == pytest.approx([POLE] * 4, abs=2e-3)
    slowness = float(np.min(np.abs(found))) / 0.8
    assert 0.3 < slowness < 1.0
    assert plant.free == len(found) - 2 * MOTOR.order
    for faster, within in ((0.0, True), (0.041, False)):
        loop = slowed_loop(plant, [1.0], POLE, slowness - faster)
        assert (noise_gain(plant, loop) <= asked / 2.0) is within


@pytest.mark.parametrize("noise", [1e3, np.inf, np.nan])
def test_no_noise_makes_the_poles_slower_than_a_quarter_of_the_asked_speed(noise: float) -> None:
    found = np.roots(detuned_loop(motor(1), POLE, noise, 1.0))
    slowest = 1.0 - SLOWEST_SHARE * (1.0 - POLE)
    assert distance(found, [slowest] * 4 + [OBSERVER_POLE] * (len(found) - 4)) < 5e-3


REST, FAR = 3.0, 3.8
REST_V = REST / 0.011
PLANT = motor(3)
A, B = PLANT.a, PLANT.b
TAPS = len(B) - 1
ASKED = PLANT.asked(POLE)


def slow_loop(slowness: float) -> list[float]:
    return slowed_loop(PLANT, [1.0], POLE, slowness)


def designed(slowness: float) -> ReferenceFilter:
    state = ReferenceFilter(MOTOR.order, TAPS)
    filter_reference(state, REST)
    copy_into(state.asked, ASKED)
    copy_into(state.loop, slow_loop(slowness))
    return state


def response(
    slowness: float, target: float, limit_V: float = math.inf, *, conditioned: bool = True
) -> Array:
    """Output after a step of the reference, on the discrete model."""
    state, gains = designed(slowness), PLANT.gains(slow_loop(slowness))
    inputs, outputs, trace = [REST_V] * TAPS, [REST] * (MOTOR.order + 1), []
    for _ in range(200):
        y = np.dot(B[1:], inputs) - np.dot(A[1:], outputs[: MOTOR.order])
        outputs = [float(y), *outputs[:-1]]
        wanted = control_law(gains, inputs, outputs, filter_reference(state, target))
        applied = min(wanted, limit_V)
        if conditioned:
            condition_reference(state, applied - wanted, sum(gains[TAPS:]))
        inputs = [applied, *inputs[:-1]]
        trace.append(outputs[0])
    return np.array(trace)


def ideal(target: float) -> Array:
    """B/B(1) A_m(1)/A_m."""
    step = np.full(200, target - REST)
    weights = np.array(B) * sum(ASKED) / sum(B)
    return np.asarray(REST + lfilter(weights, ASKED, step))


@pytest.mark.parametrize("slowness", [0.0, 0.5, 1.0, 1.6, 2.0])
def test_the_response_to_the_reference_is_the_one_asked_for(slowness: float) -> None:
    assert response(slowness, 3.2) == pytest.approx(ideal(3.2), abs=1e-6)


@pytest.mark.parametrize("slowness", [0.5, 1.0, 2.0])
def test_after_a_limit_the_output_arrives_as_soon_as_in_the_loop_that_was_asked_for(
    slowness: float,
) -> None:
    asked, slowed = response(0.0, FAR, 360.0), response(slowness, FAR, 360.0)
    assert slowed.max() <= FAR + 0.02 * (FAR - REST)
    near = 0.05 * (FAR - REST)
    arrival, earliest = (int(np.argmax(y > FAR - near)) for y in (slowed, asked))
    assert arrival <= 1.1 * earliest


def test_a_reference_that_is_not_a_number_leaves_no_trace() -> None:
    state = designed(1.0)
    assert math.isnan(filter_reference(state, math.nan))
    assert filter_reference(state, REST) == pytest.approx(REST)
    assert filter_reference(state, 3.2) == pytest.approx(filter_reference(designed(1.0), 3.2))
