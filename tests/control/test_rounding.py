"""The step of a sensor is found in its samples, and what rounding to it costs."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control import fast_half as fast
from adaptdrive.control import rounding as rd
from tests.closed_loop.bench import EXACT, MOTOR, TICK_s
from tests.control.systems import Array

SCALE = 3.3
TICKS = 120


def slow_course(seconds: float = 240.0) -> Array:
    """A movement of 0.15 V, there and back in 120 s, at 120 samples per second."""
    times_s = np.arange(round(seconds * TICKS)) / TICKS
    return 3.1 + 0.075 * np.sin(2.0 * np.pi * times_s / 120.0)


def noise(sigma: float, count: int) -> Array:
    return sigma * np.random.default_rng(3).normal(size=count)


def watched(samples: Iterable[float]) -> rd.Grid:
    values = [float(y) for y in samples]
    grid = rd.Grid(values[0])
    for n, y in enumerate(values, 1):
        rd.note_sample(grid, y, SCALE)
        if n % TICKS == 0:
            rd.close_share(grid, TICKS)
    return grid


def found(samples: Iterable[float]) -> float:
    return rd.step_found(watched(samples), SCALE)


@pytest.mark.parametrize("step", [0.02, 0.0049, 0.001])
@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.5, 3.0])
@pytest.mark.parametrize("kind", ["float64", "float32"])
def test_the_step_is_found_whatever_the_noise(step: float, ratio: float, kind: str) -> None:
    course = slow_course()
    counts = np.round((course + noise(ratio * step, len(course)) + 10.0) / step)
    assert found((counts * step - 10.0).astype(kind)) == pytest.approx(step, rel=0.01)


@pytest.mark.parametrize("scale", [1e-6, 1e-5])
@pytest.mark.parametrize("sigma", [0.0, 0.002])
def test_a_fine_scale_is_no_resolution(scale: float, sigma: float) -> None:
    course = slow_course()
    assert found(np.round((course + noise(sigma, len(course))) / scale) * scale) == 0.0


@pytest.mark.parametrize("kind", ["float64", "float32"])
@pytest.mark.parametrize("sigma", [0.0, 2e-4, 0.005, 0.05])
def test_samples_that_are_not_rounded_have_none(sigma: float, kind: str) -> None:
    course = slow_course()
    assert found((course + noise(sigma, len(course))).astype(kind)) == 0.0


def test_a_slow_sensor_that_holds_its_value_has_none() -> None:
    course = slow_course()
    assert found(np.repeat((course + noise(0.003, len(course)))[::12], 12)) == 0.0


def test_an_output_that_stands_still_shows_none() -> None:
    assert found([3.1] * 10_000) == 0.0


def test_one_movement_shows_none() -> None:
    assert found([3.0] * 1000 + [3.01] * 1000) == 0.0


def test_a_mean_of_rounded_samples_has_the_step_of_the_mean() -> None:
    course = slow_course()
    rounded = np.round((course + noise(0.005, len(course))) / 0.01) * 0.01
    assert found(np.convolve(rounded, [0.25] * 4, "valid")) == pytest.approx(0.0025, rel=0.01)


def test_single_samples_beside_the_steps_do_not_hide_them() -> None:
    samples = np.round((slow_course() + noise(0.002, len(slow_course()))) / 0.01) * 0.01
    samples[500::2000] += 0.0637
    assert found(samples) == pytest.approx(0.01, rel=0.01)


def test_a_step_outlives_one_sample_beside_the_steps_and_not_the_next() -> None:
    grid = rd.remembered_grid(0.01)
    rd.note_sample(grid, 1.0, SCALE)
    for sample, step in ((1.0143, 0.01), (1.02, 0.01), (1.0343, 0.0)):
        rd.note_sample(grid, sample, SCALE)
        assert rd.step_found(grid, SCALE) == step


def test_spikes_do_not_make_a_step() -> None:
    samples = slow_course() + noise(0.002, len(slow_course()))
    samples[::50] += noise(0.05, len(samples[::50]))
    assert found(samples) == 0.0


def test_another_sensor_is_noticed() -> None:
    course = slow_course() + noise(0.004, len(slow_course()))
    grid = watched(np.concatenate([np.round(course / q) * q for q in (0.01, 0.0037)]))
    assert rd.step_found(grid, SCALE) == pytest.approx(0.0037, rel=0.01)


def test_samples_without_steps_end_one() -> None:
    course = slow_course() + noise(0.004, len(slow_course()))
    assert found(np.concatenate([np.round(course / 0.01) * 0.01, course])) == 0.0


def test_a_sensor_too_coarse_to_be_one_is_not_believed() -> None:
    assert found([0.0, 0.5] * 100) == 0.0


@given(st.lists(st.integers(-40, 40), min_size=2, max_size=60), st.floats(1e-3, 0.02))
def test_what_is_found_is_a_multiple_of_the_step(counts: list[int], step: float) -> None:
    multiple = found(np.array(counts * 3) * step) / step
    assert multiple == pytest.approx(round(multiple), abs=0.03)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
def test_no_finite_samples_stop_the_search(samples: list[float]) -> None:
    step = found(samples)
    assert 0.0 <= step <= rd.COARSEST * SCALE


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


def rounding_of(bank: fast.FilterBank, resolution: float, *, exact: bool = True) -> float:
    learning = replace(EXACT.learning, resolution=resolution)
    return fast.take_rounding(replace(EXACT, learning=learning, exact=exact), bank)[0]


def test_a_configured_resolution_counts_before_one_that_is_found() -> None:
    bank = fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    bank.grid = watched(np.round(slow_course() / 0.01) * 0.01)
    assert rounding_of(bank, 0.0) == pytest.approx(0.01, rel=0.01)
    assert rounding_of(bank, 0.004) == 0.004


def test_the_papers_design_looks_for_none() -> None:
    bank = fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    bank.grid = watched(np.round(slow_course() / 0.01) * 0.01)
    assert rounding_of(bank, 0.0, exact=False) == 0.0


def test_a_remembered_step_of_a_sensor_that_was_replaced_is_forgotten() -> None:
    grid = rd.remembered_grid(0.01)
    for y in np.round(slow_course() / 0.0037) * 0.0037:
        rd.note_sample(grid, float(y), SCALE)
    assert rd.step_found(grid, SCALE) == pytest.approx(0.0037, rel=0.01)
