"""A bath whose sensor lags: commissioned in virtual time, then held by the adaptive controller."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adaptdrive.lab import commission, simulate
from tests.unit.devices.bench import EXAMPLES

W_PER_V2 = 0.25**2 * 7.87 / 8.87**2
RESOLUTION_K = 0.32


class Kit:
    """A heated block of 140 s whose sensor has 20 s, or none, with a step of its own."""

    step_s = 1.0

    def __init__(self, seed: int, lag_s: float, delay_s: float, tau_s: float = 140.0) -> None:
        self._random = np.random.default_rng(seed)
        self._taus_s = (tau_s, lag_s)
        self._late_W = [200.0] * round(delay_s)
        self._block_K = self._sensor_K = math.nan

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        power_W = W_PER_V2 * boost_voltage_V**2
        self._late_W.append(power_W)
        target_K = 0.021 * self._late_W.pop(0)
        if math.isnan(self._block_K):
            self._block_K = self._sensor_K = target_K
        slow, fast = (math.exp(-duration_s / tau_s) if tau_s else 0.0 for tau_s in self._taus_s)
        self._block_K += (1.0 - slow) * (target_K - self._block_K)
        self._sensor_K += (1.0 - fast) * (self._block_K - self._sensor_K)
        shown_K = self._sensor_K + 0.1 * self._random.normal()
        return round(shown_K / RESOLUTION_K) * RESOLUTION_K, power_W


@pytest.mark.proof
@pytest.mark.parametrize(("lag_s", "delay_s"), [(0.0, 0.0), (20.0, 18.0), (20.0, 0.0)])
def test_lags_and_dead_time_are_taken_where_the_record_shows_them(
    lag_s: float, delay_s: float
) -> None:
    kit = Kit(5, lag_s, delay_s)
    found = commission(EXAMPLES / "bath.toml", kit, move=0.15, patience_s=300.0)
    model, values = found.proposal.model, found.proposal.values
    assert model["resistance_K_per_W"].value == pytest.approx(0.021, rel=0.03)
    total_s = model["tau_s"].value + (model["lag_s"].value if lag_s else 0.0)
    assert total_s == pytest.approx(140.0 + lag_s, rel=0.06)
    assert ("lag_s" in model) == (lag_s > 0.0)
    late_s = model["delay_s"].value if "delay_s" in model else 0.0
    assert late_s == pytest.approx(delay_s, abs=5.0)
    if lag_s:
        assert model["lag_s"].value == pytest.approx(lag_s, abs=8.0)
        assert values["load.period_s"] == 10.0


@pytest.mark.proof
def test_adaptive_is_in_force_on_a_bath_of_twice_the_lag() -> None:
    found = commission(EXAMPLES / "bath.toml", Kit(5, 20.0, 0.0), move=0.15, patience_s=300.0)
    run = simulate(
        found.proposal.configuration,
        Kit(6, 20.0, 0.0, tau_s=280.0),
        lambda time_s: 10.0 if time_s % 1800.0 < 900.0 else 13.0,
        7200.0,
    )
    later = run.slow.filter(run.slow["time_s"] > 1800.0)
    assert later["controller"].to_list().count("adaptive") >= 0.8 * later.height
    last = run.slow.tail(1).to_dicts()[0]
    assert last["estimate_tau_sum_s"] == pytest.approx(300.0, rel=0.05)
