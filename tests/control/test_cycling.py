"""The watch for limit cycles: what sets it off, and what must not."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from adaptdrive.app.paper_design import paper_jacket
from adaptdrive.config import load_configuration
from adaptdrive.control.cycling import LONGEST_WAY, TRAVERSES, CyclingState, watch_cycling

BETTER = 5.0
EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"


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
    course = ([0.0] * half + [1.0] * half) * TRAVERSES
    assert found(course) == TRAVERSES * half


def test_a_cycle_that_does_not_reach_the_limits_is_none() -> None:
    assert found([0.2, 0.85] * 1000) is None


def test_ways_far_apart_are_none() -> None:
    assert found(([0.0] + [0.5] * LONGEST_WAY + [1.0] + [0.5] * LONGEST_WAY) * 100) is None


@pytest.mark.parametrize("better", [1.0, 2.9])
def test_noise_on_a_load_that_the_model_describes_is_none(better: float) -> None:
    noise = np.random.default_rng(4).uniform(-1.0, 2.0, 5000)
    assert found(np.clip(noise, 0.0, 1.0), better=better) is None


def test_the_papers_controller_is_not_watched() -> None:
    state = CyclingState()
    step = paper_jacket(load_configuration(EXAMPLES / "motor.toml")).swing_min
    course = [0.0, 1.0] * TRAVERSES
    assert not any(watch_cycling(state, position, 1.0, step, BETTER, True) for position in course)


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
