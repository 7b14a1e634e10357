"""The step of a sensor is found in its samples, and what rounding to it costs."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control import fast
from adaptdrive.control.estimation import filters as rd
from tests.integration.closed_loop.bench import EXACT, MOTOR, TICK_s
from tests.unit.control.systems import Array

SCALE = 3.3
TICKS = 120


def slow_course(seconds: float = 240.0) -> Array:
    """A movement of 0.15 V, there and back in 120 s, at 120 samples per second."""
    times_s = np.arange(round(seconds * TICKS)) / TICKS
    return 3.1 + 0.075 * np.sin(2.0 * np.pi * times_s / 120.0)


def noise(sigma: float, count: int) -> Array:
    return sigma * np.random.default_rng(3).normal(size=count)


def watched(samples: Iterable[float]) -> rd.Quantiser:
    values = [float(y) for y in samples]
    quantiser = rd.Quantiser(values[0])
    for n, y in enumerate(values, 1):
        rd.note_sample(quantiser, y, SCALE)
        if n % TICKS == 0:
            rd.close_share(quantiser, TICKS)
    return quantiser


def found(samples: Iterable[float]) -> float:
    return watched(samples).step


@pytest.mark.parametrize("step", [0.02, 0.0049, 0.001])
@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.5, 3.0])
@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_the_step_is_found_whatever_the_noise(step: float, ratio: float, kind: str) -> None:
    course = slow_course()
    counts = np.round((course + noise(ratio * step, len(course)) + 10.0) / step)
    assert found((counts * step - 10.0).astype(kind)) == pytest.approx(step, rel=0.01)


@pytest.mark.parametrize("kind", ["float64", "float32"])
@pytest.mark.parametrize("sigma", [0.0, 2e-4, 0.005, 0.05])
def test_samples_that_are_not_rounded_have_none(sigma: float, kind: str) -> None:
    course = slow_course()
    assert found((course + noise(sigma, len(course))).astype(kind)) == 0.0


def test_without_steps_none_is_found() -> None:
    course = slow_course()
    assert found(np.repeat((course + noise(0.003, len(course)))[::12], 12)) == 0.0
    assert found(np.round((course + noise(0.002, len(course))) / 1e-5) * 1e-5) == 0.0  # too fine
    assert found([3.1] * 10_000) == 0.0
    assert found([3.0] * 1000 + [3.01] * 1000) == 0.0
    noisy = course + noise(0.004, len(course))
    assert found(np.concatenate([np.round(noisy / 0.01) * 0.01, noisy])) == 0.0


def test_another_sensor_is_noticed() -> None:
    course = slow_course() + noise(0.004, len(slow_course()))
    quantiser = watched(np.concatenate([np.round(course / q) * q for q in (0.01, 0.0037)]))
    assert quantiser.step == pytest.approx(0.0037, rel=0.01)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
def test_no_finite_samples_stop_the_search(samples: list[float]) -> None:
    step = found(samples)
    assert 0.0 <= step < SCALE / rd.FINEST


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.2, 0.3, 0.4, 0.6])
def test_noise_takes_the_rounding_error_out_of_a_mean(ratio: float) -> None:
    """Against the means of rounded samples, at every place between two steps."""
    step, random = 0.005, np.random.default_rng(5)
    places = np.linspace(-0.5, 0.5, 200)[:, None] * step
    noisy = places + ratio * step * random.normal(size=(200, 40_000))
    rounded = np.round(noisy / step) * step
    errors = rounded.mean(axis=1) - places[:, 0]
    share = float(np.mean(np.diff(rounded, axis=1) != 0.0))
    claimed, truth = rd.rounding_error(step, share), float(np.sqrt(np.mean(errors**2)))
    assert -0.02 <= (claimed - truth) / rd.rounding_error(step, 0.0) <= 0.17


def test_a_configured_resolution_counts_before_one_that_is_found() -> None:
    """The paper's design looks for none."""
    bank = fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    bank.quantiser = watched(np.round(slow_course() / 0.01) * 0.01)
    for exact, resolution, rounding in ((True, 0.0, 0.01), (True, 0.004, 0.004), (False, 0.0, 0.0)):
        learning = replace(EXACT.learning, resolution=resolution)
        settings = replace(EXACT, learning=learning, exact=exact)
        assert fast.take_rounding(settings, bank)[0] == pytest.approx(rounding, rel=0.01)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_a_step_that_an_earlier_run_found_is_known_from_the_start(step: float) -> None:
    quantiser = rd.known_quantiser(step)
    assert quantiser.step == step
    for sample in (3.0, 3.05, 3.1):
        rd.note_sample(quantiser, sample, 3.0)
    assert quantiser.step == step
