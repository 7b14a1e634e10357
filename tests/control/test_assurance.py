"""What the covariance of an estimate leaves open of its loop, checked with numpy and scipy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from adaptdrive.control.assurance import closes_stably, possible_models, response_spread
from adaptdrive.control.design import asked_loop, compensator_gains, discrete_model
from tests.closed_loop.bench import EXACT, MOTOR
from tests.control.systems import decades

Array = NDArray[np.float64]

BOLD = replace(EXACT, jacket=replace(EXACT.jacket, confidence=2.0))


def motor_gains(tau_motor_s: float, pole: float = 0.7) -> list[float]:
    a, b = motor_model(tau_motor_s)
    return compensator_gains(a, b, 2, pole)


def motor_model(tau_motor_s: float) -> tuple[list[float], list[float]]:
    values = [0.011, tau_motor_s + 10.0, tau_motor_s * 10.0]
    return discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0)


@given(decades(2.0, 120.0), decades(2.0, 120.0), st.floats(0.5, 0.95))
def test_stability_is_that_of_the_roots(designed_s: float, true_s: float, pole: float) -> None:
    gains, (a, b) = motor_gains(designed_s, pole), motor_model(true_s)
    taps = len(gains) - 3
    forward, back = np.convolve(a, [1.0, *gains[:taps]]), np.convolve(b, gains[taps:])
    length = max(len(forward), len(back))
    closed = np.pad(forward, (0, length - len(forward))) + np.pad(back, (0, length - len(back)))
    radius = np.abs(np.roots(closed)).max()
    for margin in (0.99, 1.01):
        assert closes_stably(gains, a, b, 2, radius / margin) == (margin < 1.0)


HEAVY = [0.011, 33.4, 234.0]
ENCODER = [0.011, 23.5, 2.35]


def spread(values: list[float], root: Array, pole: float = 0.7) -> float:
    """How far the response may be off with the gains for a motor."""
    a, b = discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0)
    gains, loop = compensator_gains(a, b, 2, pole), asked_loop(b, 2, pole)
    models = possible_models(BOLD, MOTOR, values, list(root.ravel()), 1.0)
    return response_spread(2, models, gains, loop, b, pole)


def responses(values: list[float], loads: Array, pole: float = 0.7) -> Array:
    """Responses of loads to a step, with the gains for a motor, by scipy."""
    a, b = discrete_model(BOLD, MOTOR, *MOTOR.realise(values), 1.0)
    gains = compensator_gains(a, b, 2, pole)
    r, s = [1.0, *gains[: len(b) - 1]], gains[len(b) - 1 :]
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


def test_a_sure_estimate_leaves_nothing_open() -> None:
    assert spread(HEAVY, np.zeros((3, 3))) == 0.0
    assert 0.0 < spread(HEAVY, np.diag([1e-5, 0.01, 0.1])) < 0.003


def test_a_load_within_the_covariance_that_the_loop_does_not_hold_leaves_all_open() -> None:
    assert spread(HEAVY, np.diag([0.0, 0.0, 80.0]), 0.4) == math.inf


@pytest.mark.parametrize("unknown", [math.nan, math.inf])
def test_what_is_not_known_leaves_all_open(unknown: float) -> None:
    assert spread(HEAVY, np.diag([1e-5, 0.01, unknown])) == math.inf
