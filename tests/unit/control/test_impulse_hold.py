"""The course of v_bst after which the impulse-invariant model holds, against a fine simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete

from adaptdrive.control.design.pole_placement import desired_polynomial
from adaptdrive.control.loads.discretise import kick_factors
from adaptdrive.control.loads.motor import motor_load
from tests.unit.control.systems import impulse_invariant, place_poles

Array = NDArray[Any]

GAIN, MOTOR_S, FILTER_S = 0.011, 11.7, 10.0
TICKS, DELAY, WIDTH = 120, 11, 30
NO_KICK = (0.0, 0.0)


def course(factors: tuple[float, float], delay: int = DELAY) -> Array:
    """v_bst at every tick for V_c = 1 in one slow period and 0 in all others."""
    rise = np.zeros(TICKS)
    rise[:WIDTH], rise[WIDTH : 2 * WIDTH] = factors
    return np.concatenate((np.zeros(delay), 1.0 + rise, -rise))


def sampled(pulse: Array, motor_s: float = MOTOR_S) -> tuple[Array, Array]:
    """A and B of the load sampled once in 120 ticks, by simulation at every tick."""
    system = (
        np.array([[-1.0 / motor_s, 0.0], [1.0 / FILTER_S, -1.0 / FILTER_S]]),
        np.array([[GAIN / motor_s], [0.0]]),
        np.array([[0.0, 1.0]]),
        np.zeros((1, 1)),
    )
    step, gain, *_ = cont2discrete(system, 1.0 / TICKS)
    state, outputs = np.zeros((2, 1)), [0.0]
    padded = np.concatenate((pulse, np.zeros(6 * TICKS - pulse.size)))
    for tick, value in enumerate(padded, 1):
        state = step @ state + gain * value
        if tick % TICKS == 0:
            outputs.append(float(state[1, 0]))
    a = np.poly([np.exp(-1.0 / motor_s), np.exp(-1.0 / FILTER_S)])
    return a, np.convolve(a, outputs)[:5]


def poles(pulse: Array) -> Array:
    """Poles of the paper's controller, designed for (24), on that load."""
    a, b = sampled(pulse)
    model = impulse_invariant(GAIN, MOTOR_S + FILTER_S, MOTOR_S * FILTER_S, 1.0).tolist()
    r, s = place_poles(model[:3], model[3:], desired_polynomial(0.7, 4))
    loop = np.polyadd(np.pad(np.convolve(a, r), (0, 2)), np.convolve(b, s))
    return np.sort_complex(np.roots(loop))[-4:]


def test_held_the_published_poles_land_elsewhere() -> None:
    held = poles(course(NO_KICK, delay=0))
    assert np.min(np.abs(held - (0.673 + 0.296j))) < 0.01


def test_with_kicks_they_land_on_070() -> None:
    factors = kick_factors(motor_load(GAIN, MOTOR_S, FILTER_S), 1.0, DELAY / TICKS, WIDTH / TICKS)
    _, b = sampled(course(factors))
    expected = impulse_invariant(GAIN, MOTOR_S + FILTER_S, MOTOR_S * FILTER_S, 1.0)[3:]
    assert b[1] == pytest.approx(expected[1], rel=1e-3)
    assert np.abs(b[2:]).max() < 1e-9
    found = poles(course(factors))
    assert np.poly(found) == pytest.approx(np.poly([0.7] * 4), abs=5e-4)
    assert np.abs(found - 0.7).max() < 0.06
    assert found.mean().real == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize("disks", [2, 3])
def test_kicks_for_one_disk_nearly_fit_more(disks: int) -> None:
    factors = kick_factors(motor_load(GAIN, MOTOR_S, FILTER_S), 1.0, DELAY / TICKS, WIDTH / TICKS)
    tau_s = disks * MOTOR_S
    _, b = sampled(course(factors), tau_s)
    expected = impulse_invariant(GAIN, tau_s + FILTER_S, tau_s * FILTER_S, 1.0)[3:]
    assert b[1] == pytest.approx(expected[1], rel=0.01)
    assert np.abs(b[2:]).max() < 0.01 * b[1]
