"""The detector of abrupt changes: against Gaussian noise of numpy, and its documented limits."""

import numpy as np
import pytest

from adaptdrive.control.surprise import LEAST_NOISE, Surprise, is_surprising, watch_noise

SIGMA = 0.02
POWER = SIGMA * SIGMA
FLOOR = 1e-8
"""The least variance: a ten-thousandth of the scale, squared."""


def settled(power: float = POWER) -> Surprise:
    """A detector that has seen its first twenty samples, and knows σ²."""
    return Surprise(power=power, noise=power, samples=20)


def test_one_sample_above_twelve_times_the_variance_is_an_alarm() -> None:
    for ratio, expected in ((12.0, False), (12.01, True)):
        state = settled(1.0)
        assert is_surprising(state, ratio) is expected
        assert state.alarms == expected
        assert state.sum == (0.0 if expected else 9.0)


def test_several_smaller_ones_in_a_row_add_up_to_an_alarm() -> None:
    """Each adds its z² less 3; the variance grows by 3 % with each of them."""
    state, sums = settled(1.0), np.cumsum(6.0 / 1.03 ** np.arange(3) - 3.0)
    for expected in sums:
        assert not is_surprising(state, 6.0)
        assert state.sum == pytest.approx(expected)
    assert sums[-1] + 6.0 / 1.03**3 - 3.0 > 9.0
    assert is_surprising(state, 6.0)


def test_noise_alone_gives_an_alarm_in_hundreds_of_samples_and_a_change_one_at_once() -> None:
    state = settled()
    for innovation in SIGMA * np.random.default_rng(1).normal(size=20_000):
        is_surprising(state, float(innovation) ** 2)
    assert 0 < state.alarms < 20_000 / 300
    assert any(is_surprising(state, 9.0 * POWER) for _ in range(3))


@pytest.mark.parametrize("sigma", [0.003, 0.3])
def test_the_variance_is_that_of_gaussian_noise(sigma: float) -> None:
    powers, noises, state = [], [], Surprise()
    for innovation in sigma * np.random.default_rng(2).normal(size=20_000):
        watch_noise(state, float(innovation))
        is_surprising(state, float(innovation) ** 2)
        powers.append(state.power)
        noises.append(state.noise)
    assert np.median(powers[1000:]) == pytest.approx(sigma**2, rel=0.1)
    assert np.median(noises[1000:]) == pytest.approx(sigma**2, rel=0.1)


def test_a_slow_error_is_no_noise() -> None:
    state, random = Surprise(samples=100), np.random.default_rng(3)
    seen = []
    for k in range(4000):
        watch_noise(state, 0.5 + 0.01 * k + SIGMA * float(random.normal()))
        seen.append(state.noise)
    assert np.median(seen[500:]) == pytest.approx(POWER, rel=0.1)


def test_a_noiseless_output_keeps_the_least_variance() -> None:
    state = Surprise()
    for _ in range(1000):
        watch_noise(state, 0.0)
        is_surprising(state, 0.0)
    assert state.power == FLOOR
    assert state.noise == LEAST_NOISE
    state = Surprise(power=FLOOR, noise=0.0, samples=0)
    is_surprising(state, 0.0)
    assert state.power == FLOOR
