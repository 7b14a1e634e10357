"""Detection of a loop that swings, and what must not set it off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adaptdrive.control.ringing import QUICK, Ringing, is_ringing

NOISE_V = 8.0


def seen(
    inputs: list[float], noise_max: float = NOISE_V, steps: frozenset[int] = frozenset()
) -> int:
    """Samples until it rings, -1 for never."""
    state = Ringing(inputs[0])
    found = [
        is_ringing(state, one, 500.0 if k in steps else 0.0, noise_max)
        for k, one in enumerate(inputs)
    ]
    return found.index(True) if any(found) else -1


@pytest.mark.parametrize("period", [2.0, 4.0, 8.0])
@pytest.mark.parametrize("growth", [1.1, 1.3])
def test_a_swing_that_grows_is_found_before_it_has_reached_the_limits(
    period: float, growth: float
) -> None:
    """From ten volts on; growth is for each half of a swing, as in a linear loop."""
    swing = [
        300.0 + 10.0 * growth ** (2.0 * k / period) * math.cos(2.0 * math.pi * k / period)
        for k in range(200)
    ]
    at = seen(swing)
    assert at > 0
    assert max(abs(one - 300.0) for one in swing[: at + 1]) < 100.0


def test_noise_alone_does_not_ring() -> None:
    noise = NOISE_V * np.random.default_rng(7).standard_normal(100_000)
    assert seen((300.0 + noise).tolist()) == -1


def test_swings_slower_than_quick_ones_do_not_ring() -> None:
    half = QUICK + 3
    assert seen([300.0 + 60.0 * (-1.0) ** (k // half) for k in range(50 * half)]) == -1


def test_a_response_to_a_step_of_the_reference_may_have_a_swing_more() -> None:
    response = [300.0] * 5 + [400.0] * 4 + [200.0] * 4 + [330.0] * 3 + [310.0] * 50
    steps = frozenset(range(4, 20 * len(response), len(response)))
    assert seen(response * 20, steps=steps) == -1
    assert seen([300.0] * 5 + [400.0, 200.0] * 4, steps=frozenset({5})) == 9
    assert seen([300.0] * 5 + [400.0, 200.0] * 4) == 8


def test_without_a_limit_of_the_noise_nothing_rings() -> None:
    assert seen([300.0 + 90.0 * (-1.0) ** k for k in range(50)], 0.0) == -1
