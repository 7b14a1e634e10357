"""The search for the step of a sensor, difference by difference, and the share of its changes."""

import math

import numpy as np
import pytest

from adaptdrive.control import rounding as rd


def agreeing(count: int, step: float = 0.01) -> rd.Grid:
    """A search in which some differences agree with a step; the first one proposed it."""
    grid = rd.Grid(0.0)
    for number in range(count + 1):
        rd.note_sample(grid, step if number % 2 == 0 else 0.0, 1.0)
    return grid


def test_twelve_differences_that_agree_make_a_step() -> None:
    assert rd.step_found(agreeing(11), 1.0) == 0.0
    assert rd.step_found(agreeing(12), 1.0) == 0.01


def missed(grid: rd.Grid, count: int) -> rd.Grid:
    """The same search after differences of half a step more."""
    for _ in range(count):
        rd.note_sample(grid, grid.last + 0.015, 1.0)
    return grid


@pytest.mark.parametrize(("agreed", "misses"), [(12, 0), (16, 1), (20, 2), (10_000, 2)])
def test_a_difference_that_does_not_agree_counts_as_four_that_do(agreed: int, misses: int) -> None:
    assert rd.step_found(missed(agreeing(agreed), misses), 1.0) == 0.01
    assert rd.step_found(missed(agreeing(agreed), misses + 1), 1.0) == 0.0


def test_six_differences_that_do_not_agree_end_any_step() -> None:
    assert missed(agreeing(10_000), 5).candidate == 0.01
    assert missed(agreeing(10_000), 6).candidate == pytest.approx(0.005)


@pytest.mark.parametrize(("off", "agrees"), [(0.0199, True), (0.0201, False)])
@pytest.mark.parametrize("multiple", [1, 7])
def test_a_difference_agrees_within_a_fiftieth_of_a_step(
    off: float, agrees: bool, multiple: int
) -> None:
    for sign in (1.0, -1.0):
        grid = rd.Grid(0.0, candidate=0.01, score=5)
        rd.note_sample(grid, (multiple + sign * off) * 0.01, 1.0)
        assert grid.score == (6 if agrees else 1)


def test_a_difference_far_below_the_step_does_not_agree() -> None:
    grid = rd.Grid(0.0, candidate=0.01, score=5)
    rd.note_sample(grid, 0.0001, 1.0)
    assert grid.score == 1


def test_a_difference_of_a_million_steps_is_no_movement() -> None:
    for multiple, score in ((999_999, 6), (1_000_000, 5), (1_000_001, 5)):
        grid = rd.Grid(0.0, candidate=2.0**-6, score=5)
        rd.note_sample(grid, multiple * 2.0**-6, 1.0)
        assert grid.score == score


@pytest.mark.parametrize("scale", [1.0, 50.0])
def test_steps_are_looked_for_from_a_ten_thousandth_of_the_scale_on(scale: float) -> None:
    for difference, wanted in ((0.99e-4, False), (1.01e-4, True), (0.99e4, True), (1.01e4, False)):
        grid = rd.Grid(0.0)
        rd.note_sample(grid, difference * scale, scale)
        assert (grid.candidate > 0.0) is wanted


def test_what_remains_below_the_finest_step_begins_the_search_again() -> None:
    for remains, candidate in ((0.9e-4, 0.0), (1.1e-4, 1.1e-4)):
        grid = rd.Grid(0.0, candidate=0.001, score=0)
        rd.note_sample(grid, 0.003 + remains, 1.0)
        assert grid.candidate == pytest.approx(candidate, rel=1e-6)
        assert grid.score == 0


def test_the_coarsest_step_is_a_twentieth_of_the_scale() -> None:
    assert rd.step_found(agreeing(20, 0.05), 1.0) == 0.05
    assert rd.step_found(agreeing(20, 0.0501), 1.0) == 0.0
    assert rd.step_found(agreeing(20, 0.0501), 3.0) == 0.0501


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


def test_each_sample_that_differs_from_the_last_is_a_change() -> None:
    grid = rd.Grid(3.0)
    for sample in (3.0, 3.1, 3.1, 3.0, 3.0, 3.2):
        rd.note_sample(grid, sample, 3.0)
    assert grid.changes == 3


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
