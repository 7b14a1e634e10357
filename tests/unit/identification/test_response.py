"""Block responses against scipy's continuous-time simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.stats import kstest

from adaptdrive.identification.excerpt import responses
from adaptdrive.identification.result import ljung_box
from tests.unit.control.systems import System


@pytest.mark.parametrize(
    "denominator", [[1.0, 0.4], [1.0, 0.9, 0.05], [1.0, 0.2, 0.4], [1.0, 0.5, 0.0625]]
)
def test_block_means_are_those_of_a_fine_simulation(denominator: list[float]) -> None:
    period_s, fine = 0.5, 400
    inputs = np.random.default_rng(1).normal(size=60)
    time_s = np.arange(60 * fine + 1) * period_s / fine
    held = np.append(np.repeat(inputs, fine), inputs[-1])
    filters = responses(np.array(denominator), period_s)
    order = len(denominator) - 1
    found = filters.of((inputs,), range(order + 1))
    for power in range(order + 1):
        numerator = [1.0 if i == power else 0.0 for i in range(order + 1)]
        system = System(numerator, denominator).state_space()
        _, exact, _ = lsim(system, held, time_s, interp=False)
        expected = exact[:-1].reshape(60, fine).mean(axis=1)
        np.testing.assert_allclose(found[:, power], expected, atol=5e-3)


def test_white_noise_has_every_probability_as_often_as_any_other() -> None:
    random = np.random.default_rng(2)
    found = [ljung_box([random.normal(size=400)], 0) for _ in range(300)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_coloured_noise_is_not_white() -> None:
    shocks = np.random.default_rng(3).normal(size=1001)
    assert ljung_box([shocks[1:] + 0.5 * shocks[:-1]], 0) < 1e-6
