"""Runs and judges a battery with the fixed and the adaptive controller, interpreted.

The whole machine of the daemon runs, as a charge begins below the EMF and may end by itself.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from rich.console import Console

from adaptdrive.control.signals import Mode
from adaptdrive_sim.campaign.battery_scenario import (
    CELL_FULL_V,
    BatteryCampaign,
    BatteryScenario,
    draw_battery,
)
from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.campaign.judge import UNSTABLE, error_columns, rms
from adaptdrive_sim.course import Run
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.virtual import OperatedDrive
from adaptdrive_sim.world import World

Array = NDArray[np.float64]

_BEGINS_s = 60.0
_NEAR_LIMIT = 0.99
_LAST_PERIODS = 100


def run_battery(scenario: BatteryScenario, mode: Mode) -> Run:
    """Charge one battery."""
    plant = Battery(scenario.battery())
    drive = OperatedDrive(scenario.configuration(), World(plant, scenario.world()))
    drive.begin(mode)
    series_Ohm = plant.series_Ohm

    def age(time_s: float) -> None:
        plant.series_Ohm = series_Ohm * scenario.series_at(time_s)

    return drive.follow(scenario.duration_s, scenario.setpoint_at, age)


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


def judge_batteries(campaign: BatteryCampaign, seed: int) -> Row:
    """Run one scenario with both controllers and judge them: one row of the results."""
    scenario = draw_battery(campaign, seed)
    runs = {mode: run_battery(scenario, mode) for mode in (Mode.FIXED, Mode.ADAPTIVE)}
    row: Row = dataclasses.asdict(scenario)
    row |= {"full_V": CELL_FULL_V * scenario.cells, "current_A": scenario.current_A}
    row |= {"changes": int(scenario.growth > 1.0), "shape": "square"}
    for mode, run in runs.items():
        row |= _judged(scenario, run, mode.value)
    row["ratio"] = row["cost_adaptive"] / row["cost_fixed"]
    return row | _ripple(scenario, runs[Mode.ADAPTIVE])


def _judged(scenario: BatteryScenario, run: Run, name: str) -> Row:
    """Cost of one controller at constant current, over the step of the set-point."""
    errors = np.array([np.inf])
    if not run.trip:
        pole = scenario.configuration().load.pole
        errors = (run["output"] - ideal_current(run["reference"], pole)) / scenario.step_A
        errors = errors[_constant(scenario, run)]
    if errors.size == 0:
        errors = np.zeros(1)  # at the voltage limit from the start: nothing is judged
    return error_columns(name, errors) | {
        f"unstable_{name}": not rms(errors[-_LAST_PERIODS:]) < UNSTABLE,
        f"interlock_{name}": int(bool(run.trip)),
        f"trip_{name}": run.trip,
        f"refused_{name}": len(run.refused),
    }


def _constant(scenario: BatteryScenario, run: Run) -> NDArray[np.bool_]:
    """Return the slow periods at constant current: from its start to the voltage limit."""
    near_V = _NEAR_LIMIT * CELL_FULL_V * scenario.cells
    reached = np.flatnonzero(run["terminal_voltage_V"] >= near_V)
    end = reached[0] if reached.size else len(run.trace)
    within: NDArray[np.bool_] = run["time_s"] >= _BEGINS_s
    return within & (np.arange(len(run.trace)) < end)


def _ripple(scenario: BatteryScenario, run: Run) -> Row:
    """Return the share of constant current with adaptive in force, and the ripple."""
    constant = _constant(scenario, run)
    if run.trip or not np.any(constant):
        return {"adaptive_share": 0.0, "ripple_found": float("nan"), "constant_s": 0.0}
    outputs = run["output"][constant & (run["time_s"] < 0.7 * scenario.duration_s)]
    ripple = float(np.ptp(outputs) / scenario.current_A) if outputs.size else float("nan")
    return {
        "adaptive_share": float(np.mean(run["adaptive"][constant])),
        "ripple_found": ripple,
        "constant_s": float(np.count_nonzero(constant)),
    }


def summarise_batteries(rows: list[Row]) -> str:
    """Return the time that adaptive was in force, and the largest ripple."""
    shares = np.array([row["adaptive_share"] for row in rows])
    ripples = np.array([row["ripple_found"] for row in rows])
    largest = 100.0 * np.max(ripples, initial=0.0, where=np.isfinite(ripples))
    half = np.count_nonzero(shares >= 0.5)
    return (
        f"adaptive in force for half of the constant current or more in {half} of "
        f"{len(rows)} runs, "
        f"median {100.0 * np.median(shares):.0f} %; largest ripple {largest:.2f} % peak to peak"
    )


def repeat_battery(campaign: BatteryCampaign, seed: int, output: Path, console: Console) -> None:
    """Run one seed with both controllers; write run-SEED.parquet and print its row."""
    tables = [_recorded(campaign, seed, mode) for mode in (Mode.FIXED, Mode.ADAPTIVE)]
    path = output / f"run-{seed}.parquet"
    pq.write_table(pa.concat_tables(tables), path)
    for name, value in judge_batteries(campaign, seed).items():
        console.print(f"{name:26} {value}")
    console.print(f"recorded: {path}")


def _recorded(campaign: BatteryCampaign, seed: int, mode: Mode) -> pa.Table:
    """Return the course of a run, a row for each slow period."""
    run = run_battery(draw_battery(campaign, seed), mode)
    columns: dict[str, Any] = {
        "time_s": run["time_s"],
        "reference_A": run["reference"],
        "current_A": run["output"],
        "terminal_V": run["terminal_voltage_V"],
        "adaptive": run["adaptive"] > 0.0,
        "reason": [one.reason for one in run.decisions],
        "mode": [mode.value] * len(run.trace),
    }
    return pa.table(columns)
