"""A plant of the user in closed loop, as tables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import polars as pl

from adaptdrive.analysis.closed_loop import LoopRecord, Plant, run_loop
from adaptdrive.app.settings import tick_s
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Mode, Order, Stage
from adaptdrive.util.errors import IdentificationError


@dataclass(frozen=True, slots=True)
class Simulation:
    """A simulated closed loop.

    Attributes:
        ticks: Time, set-point, output, boost voltage and load power at each reading.
        slow: Each slow step: output, V_c, controller, reason, estimates and their deviations.
        fault: Cause that ended it early, empty for none.
        configuration: The one that the controller ran with.
    """

    ticks: pl.DataFrame
    slow: pl.DataFrame
    fault: str
    configuration: Configuration


def simulated(
    configuration: Configuration,
    plant: Plant,
    setpoint: Callable[[float], float],
    duration_s: float,
    mode: Mode,
) -> Simulation:
    """Run the controller of a configuration on a plant.

    Args:
        configuration: The configuration.
        plant: The plant.
        setpoint: Set-point at each time, in s.
        duration_s: Simulated time.
        mode: Controller asked for.

    Raises:
        IdentificationError: A set-point, or a value that the plant returns, is not finite.
    """
    reading_s = tick_s(configuration) * configuration.bus.ticks_per_reading
    pole = configuration.load.pole

    def order(number: int) -> Order:
        return Order(Stage.RUN, _finite(setpoint, number * reading_s), mode, pole)

    record = run_loop(configuration, plant, order, round(duration_s / reading_s))
    slow = _slow(record, tick_s(configuration))
    return Simulation(_ticks(record), slow, record.fault, configuration)


def _finite(setpoint: Callable[[float], float], time_s: float) -> float:
    wanted = float(setpoint(time_s))
    if not math.isfinite(wanted):
        raise IdentificationError(f"the set-point at {time_s:g} s is {wanted}")
    return wanted


def _ticks(record: LoopRecord) -> pl.DataFrame:
    names = ("time_s", "reference", "output", "boost_voltage_V", "load_power_W")
    return pl.DataFrame({name: getattr(record, name) for name in names})


def _slow(record: LoopRecord, half_cycle_s: float) -> pl.DataFrame:
    rows = [
        {
            "time_s": snapshot.tick * half_cycle_s,
            "reference": snapshot.order.reference,
            "output": snapshot.output,
            "boost_reference_V": decision.boost_reference_V,
            "controller": str(decision.controller),
            "accepted": decision.accepted,
            "reason": decision.reason,
            **{f"estimate_{name}": one.value for name, one in decision.estimates.items()},
            **{f"estimate_{name}_std": one.std for name, one in decision.estimates.items()},
        }
        for snapshot, decision in zip(record.snapshots, record.decisions, strict=True)
    ]
    return pl.DataFrame(rows)
