"""The step of a sensor is found in its samples, and what rounding to it costs."""

import math
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
    assert found([0.0, 0.5] * 100) == 0.0  # too coarse to be one
    noisy = course + noise(0.004, len(course))
    assert found(np.concatenate([np.round(noisy / 0.01) * 0.01, noisy])) == 0.0


def test_a_mean_of_rounded_samples_has_the_step_of_the_mean() -> None:
    course = slow_course()
    rounded = np.round((course + noise(0.005, len(course))) / 0.01) * 0.01
    assert found(np.convolve(rounded, [0.25] * 4, "valid")) == pytest.approx(0.0025, rel=0.01)


def test_another_sensor_is_noticed() -> None:
    course = slow_course() + noise(0.004, len(slow_course()))
    grid = watched(np.concatenate([np.round(course / q) * q for q in (0.01, 0.0037)]))
    assert rd.step_found(grid, SCALE) == pytest.approx(0.0037, rel=0.01)


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


def test_a_configured_resolution_counts_before_one_that_is_found() -> None:
    """The paper's design looks for none."""
    bank = fast.new_filter_bank(MOTOR, TICK_s, 10.0, 3.0, 280.0)
    bank.grid = watched(np.round(slow_course() / 0.01) * 0.01)
    for exact, resolution, rounding in ((True, 0.0, 0.01), (True, 0.004, 0.004), (False, 0.0, 0.0)):
        learning = replace(EXACT.learning, resolution=resolution)
        settings = replace(EXACT, learning=learning, exact=exact)
        assert fast.take_rounding(settings, bank)[0] == pytest.approx(rounding, rel=0.01)


def test_the_share_of_changes_is_the_mean_of_sixty_periods_at_most() -> None:
    counts = np.random.default_rng(2).integers(0, 20, 60)
    grid = rd.Grid(0.0)
    for number, changes in enumerate(counts, 1):
        grid.changes = int(changes)
        rd.close_share(grid, 20)
        assert grid.changes == 0
        assert grid.share == pytest.approx(np.mean(counts[:number]) / 20.0)
    before, grid.changes = grid.share, 40
    rd.close_share(grid, 20)
    assert grid.share == pytest.approx(before + (1.0 - before) / 60.0)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4])
def test_the_rounding_error_is_that_of_widrow_and_kollar(share: float) -> None:
    """q/√12 exp(-2 π² σ²/q²), with two samples 2 σ/√π = p q apart on average."""
    step = 0.02
    sigma = 0.5 * math.sqrt(math.pi) * share * step
    expected = step / math.sqrt(12.0) * math.exp(-2.0 * math.pi**2 * (sigma / step) ** 2)
    assert rd.rounding_error(step, share) == pytest.approx(expected)


@pytest.mark.parametrize("step", [0.0, 0.05])
def test_a_step_that_an_earlier_run_found_is_known_from_the_start(step: float) -> None:
    grid = rd.remembered_grid(step)
    assert rd.step_found(grid, 3.0) == step
    for sample in (3.0, 3.05, 3.1):
        rd.note_sample(grid, sample, 3.0)
    assert rd.step_found(grid, 3.0) == step


@pytest.mark.parametrize(
    ("agreed", "misses", "step", "found"),
    [
        (11, 0, 0.01, 0.0),
        (12, 0, 0.01, 0.01),  # twelve differences that agree make a step
        (12, 1, 0.01, 0.0),
        (16, 1, 0.01, 0.01),  # one that does not counts as four that do
        (16, 2, 0.01, 0.0),
        (10_000, 2, 0.01, 0.01),
        (10_000, 3, 0.01, 0.0),
        (20, 0, 0.05, 0.05),  # the coarsest step is a twentieth of the scale
        (20, 0, 0.0501, 0.0),
    ],
)
def test_enough_differences_that_agree_make_a_step(
    agreed: int, misses: int, step: float, found: float
) -> None:
    grid = rd.Grid(0.0)
    for number in range(agreed + 1):  # the first difference proposes the step
        rd.note_sample(grid, step if number % 2 == 0 else 0.0, 1.0)
    for _ in range(misses):
        rd.note_sample(grid, grid.last + 1.5 * step, 1.0)
    assert rd.step_found(grid, 1.0) == found


@pytest.mark.parametrize(
    ("difference", "score"),
    [(0.0199, 1), (0.9801, 6), (0.9799, 1), (1.0199, 6), (1.0201, 1), (7.0199, 6), (7.0201, 1),
     (999_999, 6), (1_000_000, 5), (1_000_001, 5)],
)  # fmt: skip
def test_a_difference_agrees_within_a_fiftieth_of_a_step(difference: float, score: int) -> None:
    """In steps; a million of them are no movement."""
    grid = rd.Grid(0.0, candidate=2.0**-6, score=5)
    rd.note_sample(grid, difference * 2.0**-6, 1.0)
    assert grid.score == score
