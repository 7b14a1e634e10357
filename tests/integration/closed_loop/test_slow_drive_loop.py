"""A drive that holds its own boost voltage slowly: the design counts the lag that it is given."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from adaptdrive.control.signals import Command
from adaptdrive_sim.devices.drive import VoltageHolder
from adaptdrive_sim.plants.boost import Sample
from tests.integration.closed_loop.bench import EXACT, RATES, STAGE, Bench, TICK_s, order

HOLDER_TICKS = 9.0
"""Mean delay of the simulated drive's own loop, which follows the low-pass."""

LOW, STEP, POLE = 2.9, 0.1, 0.5
"""A step so small that no limit is met, at the fastest pole that an operator may ask for."""


class SlowDriveBench(Bench):
    """A drive whose V_c passes a low-pass of first order before its own loop follows it."""

    def __init__(self, tau_s: float, lag_ticks: float) -> None:
        stage, rates = replace(STAGE, holds_voltage=True), replace(RATES, lag_ticks=lag_ticks)
        super().__init__(replace(EXACT, stage=stage, rates=rates), output=LOW)
        self._share = -math.expm1(-TICK_s / tau_s)
        self._reference_V = self.world.boost_voltage_for(LOW)
        self._holder = VoltageHolder(STAGE.capacitance_F, bidirectional=False)

    def drive(self, command: Command, sample: Sample) -> Sample:
        self._reference_V += self._share * (command.boost_reference_V - self._reference_V)
        scale_S = self._holder.scale_S(self._reference_V, sample)
        return self.world.step(scale_S, command.bridge)


def step_response(tau_s: float, lag_ticks: float) -> list[float]:
    """Output in shares of the step, second by second after it."""
    bench = SlowDriveBench(tau_s, lag_ticks)
    bench.run(20.0, order(LOW, pole=POLE))
    response = []
    for _ in range(60):
        bench.run(1.0, order(LOW + STEP, pole=POLE))
        response.append((bench.world.true_output - LOW) / STEP)
    return response


def overshoot(tau_s: float, lag_ticks: float) -> float:
    return max(step_response(tau_s, lag_ticks)) - 1.0


@pytest.mark.parametrize(
    ("tau_s", "without", "with_lag"), [(0.5, 0.015, 0.001), (0.9, 0.08, 0.005)]
)
def test_a_known_lag_ends_the_overshoot(tau_s: float, without: float, with_lag: float) -> None:
    assert overshoot(tau_s, RATES.lag_ticks) > without
    assert overshoot(tau_s, HOLDER_TICKS + tau_s / TICK_s) < with_lag
