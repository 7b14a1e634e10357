"""The outlier_filter: spikes are clipped, honest changes pass."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.estimation.filters import WIDE, OutlierFilter, reject_outlier
from adaptdrive.control.thresholds import FEWEST
from tests.unit.control.systems import Array

CLIP = 4.0
EXACT = 1e-12
"""Rounding of a sample that passes unclipped."""


def screened(samples: Array, *, level: float = 3.0, ticks: int = 1) -> tuple[Array, OutlierFilter]:
    outlier_filter = OutlierFilter(level, 0.0, WIDE * level)
    return np.array(
        [reject_outlier(outlier_filter, float(y), CLIP, ticks) for y in samples]
    ), outlier_filter


def gaussian(count: int, sigma: float) -> Array:
    return 3.0 + sigma * np.random.default_rng(8).normal(size=count)


def test_the_deviation_is_that_of_gaussian_noise() -> None:
    samples = gaussian(5000, 0.01)
    passed, outlier_filter = screened(samples)
    assert outlier_filter.deviation == pytest.approx(0.8 * 0.01, rel=0.25)
    assert np.mean(abs(passed - samples) > EXACT) < 0.01
    assert np.mean(passed) == pytest.approx(np.mean(samples), abs=1e-4)


def test_a_spike_counts_as_no_more_than_the_clip() -> None:
    samples = gaussian(2000, 0.001)
    samples[1500] += 5.0
    passed, _ = screened(samples)
    assert abs(passed[1500] - 3.0) < 2.0 * CLIP * 0.001
    assert abs(passed[1501:] - samples[1501:]).max() < 0.001


def test_a_lasting_step_opens_the_screen_within_half_a_second() -> None:
    samples = gaussian(2400, 0.001)
    samples[1200:] += 1.0
    passed, _ = screened(samples)
    assert abs(passed - samples)[1260:].max() < 0.005


@pytest.mark.parametrize("ticks", [2, 12, 60, 120])
@pytest.mark.parametrize("tau_s", [0.3, 0.6, 10.0])
def test_a_rise_from_rest_passes_a_second_late_at_most_however_seldom_samples_come(
    ticks: int, tau_s: float
) -> None:
    """A drive polled ten times a second is not controlled for seconds on old values."""
    times_s = np.arange(400) * ticks / 120.0
    start_s = times_s[200]
    rise = 120.0 * (1.0 - np.exp(-np.maximum(0.0, times_s - start_s) / tau_s))
    noise = 0.03 * np.random.default_rng(8).normal(size=400)
    passed, _ = screened(rise + noise, level=1.0, ticks=ticks)
    late = times_s >= start_s + max(1.0, 8.5 * ticks / 120.0)
    assert abs(passed - rise)[late].max() < 0.05 * 120.0


@pytest.mark.parametrize("ticks", [12, 120])
def test_spikes_among_seldom_samples_are_clipped(ticks: int) -> None:
    random = np.random.default_rng(8)
    spikes = 2.0 * random.choice([-1.0, 1.0], size=2000) * (random.random(2000) < 0.03)
    passed, _ = screened(gaussian(2000, 0.01) + spikes, ticks=ticks)
    assert np.std(passed) < 0.1 * np.std(spikes)


@given(st.lists(st.floats(-1e6, 1e6), max_size=60))
def test_what_passes_lies_between_the_prediction_and_the_sample(samples: list[float]) -> None:
    outlier_filter = OutlierFilter(3.0, 0.0, 0.03)
    for sample in samples:
        predicted, limit = (
            outlier_filter.level + outlier_filter.slope,
            CLIP * outlier_filter.deviation,
        )
        passed = reject_outlier(outlier_filter, sample, CLIP, 1)
        rounding = 1e-9 * (1.0 + abs(sample) + abs(predicted))
        assert min(predicted, sample) - rounding <= passed <= max(predicted, sample) + rounding
        opened = outlier_filter.beyond == 0 and abs(sample - predicted) > limit
        assert opened or abs(passed - predicted) <= limit + rounding


def test_a_noiseless_output_does_not_close_the_screen() -> None:
    outlier_filter = OutlierFilter(3.0, 0.0, 1.0)
    for _ in range(5000):
        reject_outlier(outlier_filter, 3.0, CLIP, 1, least=1e-4)
    assert outlier_filter.deviation == 1e-4


STEP = 0.026


def still(kind: str, level: float) -> Iterator[float]:
    """Yield a thousand samples of a load at rest."""
    for number in range(1000):
        match kind:
            case "constant":
                yield level
            case "quantised":
                yield round(level / STEP) * STEP
            case _:
                yield round(level / STEP + 0.5 * (number % 2)) * STEP


@pytest.mark.parametrize("kind", ["constant", "quantised", "one digit up and down"])
@given(
    level=st.sampled_from([0.0, 0.003, 75.0]),
    change=st.floats(-100.0, 100.0),
    ticks=st.integers(1, 12),
)
def test_a_change_after_a_standstill_passes_in_five(
    kind: str, level: float, change: float, ticks: int
) -> None:
    outlier_filter = OutlierFilter(level, 0.0, 0.01 * level)
    for sample in still(kind, level):
        reject_outlier(outlier_filter, sample, CLIP, ticks)
    passed = [
        reject_outlier(outlier_filter, level + change, CLIP, ticks) for _ in range(3 * FEWEST)
    ]
    assert passed[FEWEST - 1 :] == pytest.approx([level + change] * (2 * FEWEST + 1), abs=STEP)
