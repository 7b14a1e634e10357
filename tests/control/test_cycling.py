"""The watch for limit cycles: what sets it off, and what must not."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from adaptdrive.app.settings import controller_settings
from adaptdrive.control.cycling import CyclingState, watch_cycling
from tests.config.documents import parse

BETTER = 5.0
WAYS = 60
LONGEST = 60
"""Slow periods."""


def found(
    positions: Iterable[float],
    *,
    reference: float = 1.0,
    better: float = BETTER,
    fixed: bool = True,
) -> int | None:
    """Periods until a limit cycle is found at a constant set-point."""
    state = CyclingState()
    for number, position in enumerate(positions):
        if watch_cycling(state, position, 1.0, 0.01, better, fixed):
            return number
    return None


@pytest.mark.parametrize("half", [1, 5, 40])
def test_an_input_that_goes_from_limit_to_limit_is_found(half: int) -> None:
    course = ([0.0] * half + [1.0] * half) * WAYS
    assert found(course) == WAYS * half


def test_a_cycle_that_does_not_reach_the_limits_is_none() -> None:
    assert found([0.2, 0.85] * 1000) is None


def test_ways_far_apart_are_none() -> None:
    assert found(([0.0] + [0.5] * LONGEST + [1.0] + [0.5] * LONGEST) * 100) is None
    shorter = [0.5] * (LONGEST - 1)
    assert found(([0.0, *shorter, 1.0, *shorter]) * 100) == WAYS * LONGEST


def test_a_pause_begins_the_count_anew() -> None:
    course = [0.0, 1.0] * 20 + [0.5] * (LONGEST + 1) + [0.0, 1.0] * 100
    assert found(course) == 40 + LONGEST + 1 + WAYS


@pytest.mark.parametrize(
    ("low", "high", "cycles"),
    [(0.1, 0.9, True), (0.101, 0.9, False), (0.1, 0.899, False), (-0.5, 1.5, True)],
)
def test_a_tenth_of_the_range_from_a_limit_is_at_the_limit(
    low: float, high: float, cycles: bool
) -> None:
    assert (found([low, high] * 200) is not None) is cycles


@pytest.mark.parametrize(("better", "cycles"), [(3.0, False), (3.01, True)])
def test_an_estimate_must_predict_three_times_better(better: float, cycles: bool) -> None:
    assert (found([0.0, 1.0] * 200, better=better) is not None) is cycles


@pytest.mark.parametrize(("step", "cycles"), [(0.0078125, True), (0.0079, False)])
def test_a_set_point_that_trembles_by_less_than_its_step_rests(step: float, cycles: bool) -> None:
    state = CyclingState(reference=1.0)
    seen = [
        watch_cycling(state, float(k % 2), 1.0 + (k % 2) * step, 0.0078125, BETTER, fixed=True)
        for k in range(200)
    ]
    assert any(seen) is cycles


def test_the_adaptive_controller_begins_the_count_anew() -> None:
    state = CyclingState()
    fixed = [True] * 50 + [False] + [True] * 200
    seen = [watch_cycling(state, float(k % 2), 1.0, 0.01, BETTER, f) for k, f in enumerate(fixed)]
    # at the period of the other controller the input arrives at a limit already
    assert seen.index(True) == 50 + WAYS


@pytest.mark.parametrize("better", [1.0, 2.9])
def test_noise_on_a_load_that_the_model_describes_is_none(better: float) -> None:
    noise = np.random.default_rng(4).uniform(-1.0, 2.0, 5000)
    assert found(np.clip(noise, 0.0, 1.0), better=better) is None


def test_the_papers_controller_is_not_watched() -> None:
    state = CyclingState()
    step = controller_settings(parse(load__design='"paper"')).jacket.swing_min
    course = [0.0, 1.0] * WAYS
    seen = [watch_cycling(state, position, 1.0, step, BETTER, True) for position in course]
    assert seen == [False] * len(course)


def test_another_controller_is_not_watched() -> None:
    assert found([0.0, 1.0] * 1000, fixed=False) is None


def test_a_set_point_that_moves_begins_the_count_anew() -> None:
    state = CyclingState()
    course = ([0.0] * 3 + [1.0] * 3) * 1000
    seen = [
        watch_cycling(state, position, 1.0 + (number // 60) % 2, 0.01, BETTER, fixed=True)
        for number, position in enumerate(course)
    ]
    assert not any(seen)
