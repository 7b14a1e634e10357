"""A leak is found in noise and in steps; peaks and a slow start are none."""

from __future__ import annotations

import random

import pytest

from tools.soak.flat import COUNT, MEMORY_MiB, Trend, trend

HOURS = [0.1 * i for i in range(100)]


def memory(gain_MiB: float, *, noise_MiB: float = 0.5) -> Trend:
    """The trend of a process of 80 MiB that starts up, has peaks, and grows by so much."""
    draw = random.Random(1)
    values = [80.0 + gain_MiB * hour / HOURS[-1] + draw.gauss(0.0, noise_MiB) for hour in HOURS]
    for start in range(10):
        values[start] -= 30.0 / (1 + start)
    values[60] += 50.0
    return trend(HOURS, values, MEMORY_MiB)


def test_noise_peaks_and_a_slow_start_are_flat() -> None:
    found = memory(0.0)
    assert found.flat
    assert abs(found.gain) < 0.5


def test_a_leak_within_the_noise_is_found() -> None:
    found = memory(8.0)
    assert not found.flat
    assert found.per_hour == pytest.approx(8.0 / HOURS[-1], rel=0.1)


def test_a_descriptor_that_stays_open_now_and_then_is_found() -> None:
    values = [20.0 + i // 20 for i in range(len(HOURS))]
    assert not trend(HOURS, values, COUNT).flat
    assert trend(HOURS, [20.0 + i % 2 for i in range(len(HOURS))], COUNT).flat


def test_of_a_few_samples_nothing_is_said() -> None:
    with pytest.raises(ValueError, match="7 samples"):
        trend(HOURS[:7], HOURS[:7], COUNT)
