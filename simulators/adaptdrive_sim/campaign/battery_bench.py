"""Runs of batteries, interpreted.

The whole machine of the daemon runs, as a charge begins below the EMF and may end by itself.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.battery_scenario import (
    CELL_FULL_V,
    BatteryScenario,
)
from adaptdrive_sim.campaign.drawn import Row, Trial, columns_of
from adaptdrive_sim.course import Array, Run
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.virtual import OperatedDrive
from adaptdrive_sim.world import World

_BEGINS_s = 60.0
_NEAR_LIMIT = 0.99


def ideal_current(references: Array, pole: float) -> Array:
    """Return the current of the loop as designed: its zero cancels one of two poles.

    Args:
        references: What was asked for in each slow period.
        pole: Closed-loop pole.
    """
    found = np.array(references, dtype=float)
    for k in range(1, found.size):
        found[k] = pole * found[k - 1] + (1.0 - pole) * references[k - 1]
    return found


class BatteryTrial(Trial):
    """One scenario of a battery; judged at constant current, over the step of the set-point."""

    compiled = False
    cycle_periods = 100

    def __init__(self, scenario: BatteryScenario) -> None:
        self.scenario = scenario
        self.step = self.largest_movement = scenario.step_A

    def columns(self) -> Row:
        """Return the drawn values as columns of the results."""
        own = self.scenario
        row = columns_of(own) | {"full_V": CELL_FULL_V * own.cells, "current_A": own.current_A}
        return row | {"changes": int(own.growth > 1.0), "shape": "square"}

    def run(self, mode: Mode) -> Run:
        """Charge the battery."""
        own, plant = self.scenario, Battery(self.scenario.battery())
        drive = OperatedDrive(own.configuration(), World(plant, own.world()))
        drive.begin(mode)
        series_Ohm = plant.series_Ohm

        def age(time_s: float) -> None:
            plant.series_Ohm = series_Ohm * own.series_at(time_s)

        run = drive.follow(own.duration_s, own.setpoint_at, age)
        run.interlock = int(bool(run.trip))
        return run

    run_deployed = run

    def errors(self, run: Run) -> Array:
        """Return the differences to the designed loop at constant current."""
        if run.trip:
            return np.array([np.inf])
        pole = self.scenario.configuration().load.pole
        errors: Array = (run["output"] - ideal_current(run["reference"], pole)) / self.step
        errors = errors[self._constant(run)]
        return errors if errors.size else np.zeros(1)  # at the voltage limit from the start

    def seen(self, run: Run) -> Row:
        """Return the share of constant current with adaptive in force, and the ripple."""
        constant, own = self._constant(run), self.scenario
        if run.trip or not np.any(constant):
            return {"adaptive_share": 0.0, "ripple_found": math.nan, "constant_s": 0.0}
        outputs = run["output"][constant & (run["time_s"] < 0.7 * own.duration_s)]
        return {
            "adaptive_share": float(np.mean(run["adaptive"][constant])),
            "ripple_found": float(np.ptp(outputs) / own.current_A) if outputs.size else math.nan,
            "constant_s": float(np.count_nonzero(constant)),
        }

    def _constant(self, run: Run) -> NDArray[np.bool_]:
        """Return the slow periods at constant current: from its start to the voltage limit."""
        near_V = _NEAR_LIMIT * CELL_FULL_V * self.scenario.cells
        reached = np.flatnonzero(run["terminal_voltage_V"] >= near_V)
        end = reached[0] if reached.size else len(run.trace)
        within: NDArray[np.bool_] = run["time_s"] >= _BEGINS_s
        return within & (np.arange(len(run.trace)) < end)

    @staticmethod
    def summarise(rows: list[Row]) -> str:
        """Return the time that adaptive was in force, and the largest ripple."""
        shares = np.array([row["adaptive_share"] for row in rows])
        ripples = np.array([row["ripple_found"] for row in rows])
        largest = 100.0 * np.max(ripples, initial=0.0, where=np.isfinite(ripples))
        half = np.count_nonzero(shares >= 0.5)
        return (
            f"adaptive in force for half of the constant current or more in {half} of "
            f"{len(rows)} runs, median {100.0 * np.median(shares):.0f} %; "
            f"largest ripple {largest:.2f} % peak to peak"
        )
