"""The screen: spikes are clipped, honest changes pass."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.screen import WIDE, Screen, pass_sample
from tests.control.systems import Array

CLIP = 4.0


def screened(samples: Array, *, level: float = 3.0) -> tuple[Array, Screen]:
    screen = Screen(level, 0.0, WIDE * level)
    return np.array([pass_sample(screen, float(y), CLIP) for y in samples]), screen


def gaussian(count: int, sigma: float) -> Array:
    return 3.0 + sigma * np.random.default_rng(8).normal(size=count)


def test_what_rests_passes_unchanged() -> None:
    passed, screen = screened(np.full(5000, 3.0))
    assert (passed == 3.0).all()
    assert screen.clipped == 0


def test_the_deviation_is_that_of_gaussian_noise() -> None:
    samples = gaussian(5000, 0.01)
    passed, screen = screened(samples)
    assert screen.deviation == pytest.approx(0.8 * 0.01, rel=0.25)
    assert screen.clipped < 0.01 * len(samples)
    assert np.mean(passed) == pytest.approx(np.mean(samples), abs=1e-4)


def test_a_spike_counts_as_no_more_than_the_clip() -> None:
    samples = gaussian(2000, 0.001)
    samples[1500] += 5.0
    passed, screen = screened(samples)
    assert abs(passed[1500] - 3.0) < 2.0 * CLIP * 0.001
    assert abs(passed[1501:] - samples[1501:]).max() < 0.001
    assert screen.clipped >= 1


def test_a_ramp_passes_without_being_clipped_for_long() -> None:
    samples = gaussian(2400, 0.001) + np.maximum(0.0, np.arange(2400) - 1200) * 1e-3
    passed, _ = screened(samples)
    assert abs(passed - samples)[1200 + 60 :].max() < 0.005


def test_a_lasting_step_opens_the_screen_within_half_a_second() -> None:
    samples = gaussian(2400, 0.001)
    samples[1200:] += 1.0
    passed, _ = screened(samples)
    assert abs(passed - samples)[1260:].max() < 0.005


@given(st.lists(st.floats(-1e6, 1e6), max_size=60))
def test_what_passes_lies_between_the_prediction_and_the_sample(samples: list[float]) -> None:
    screen = Screen(3.0, 0.0, 0.03)
    for sample in samples:
        predicted, limit = screen.level + screen.slope, CLIP * screen.deviation
        passed = pass_sample(screen, sample, CLIP)
        rounding = 1e-9 * (1.0 + abs(sample) + abs(predicted))
        assert min(predicted, sample) - rounding <= passed <= max(predicted, sample) + rounding
        assert abs(passed - predicted) <= limit + rounding
