"""A load far from the configured model is named as such, with the remedy."""

from __future__ import annotations

from typing import Any, Literal

import pytest

from adaptdrive.lab import simulate
from tests.support import sample
from tests.unit.devices.bench import EXAMPLES


class FirstOrderPair:
    """A motor and its tachometer, a multiple of the configured time constants slow."""

    def __init__(self, slowness: float) -> None:
        self._slowness = slowness
        self._speed = self._output = 0.0

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        scaled_s = duration_s / self._slowness
        self._speed += scaled_s / 11.7 * (0.011 * boost_voltage_V - self._speed)
        self._output += scaled_s / 10.0 * (self._speed - self._output)
        return self._output, 0.0022 * boost_voltage_V**2


def reasons(slowness: float) -> list[str]:
    def square(time_s: float) -> float:
        return 3.2 if time_s % 60.0 < 30.0 else 3.0

    run: Any = simulate(EXAMPLES / "motor.toml", FirstOrderPair(slowness), square, 240.0)
    return list(run.slow["reason"])


def test_a_load_six_times_faster_than_its_model_is_called_that() -> None:
    last = reasons(1.0 / 6.0)[-1]
    assert "times better than [load.model]: the load is 5" in last
    assert last.endswith("times faster than [load.model]; commission this load")


@pytest.mark.parametrize("mode", sample(["adaptive", "fixed"], 1))
def test_a_limit_cycle_on_such_a_load_ends_in_the_safe_state(mode: Literal["fixed"]) -> None:
    plant = FirstOrderPair(1.0 / 6.0)
    run: Any = simulate(EXAMPLES / "motor.toml", plant, 3.2, 600.0, mode)
    assert run.fault == "limit cycle: the fixed controller drives V_c from limit to limit"
    assert len(run.slow["reason"]) < 150


def test_a_limit_cycle_that_the_adaptive_controller_ends_does_not_trip() -> None:
    run: Any = simulate(EXAMPLES / "motor.toml", FirstOrderPair(0.5), 3.2, 300.0)
    assert run.fault == ""
    assert run.slow["controller"][-1] == "adaptive"


def test_a_load_within_the_bounds_is_trusted_without_advice() -> None:
    found = reasons(0.6)
    assert found[-1] == ""
    assert not any("commission" in reason for reason in found)
