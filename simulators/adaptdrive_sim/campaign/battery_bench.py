"""Runs and judges a battery with the fixed and the adaptive controller, interpreted.

The whole machine of the daemon runs, as a charge begins below the EMF and may end by itself.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Enable, SetMode, SetSetpoint
from adaptdrive_sim.campaign.battery_scenario import CELL_FULL_V, BatteryScenario, draw_battery
from adaptdrive_sim.campaign.battery_settings import BatteryCampaign
from adaptdrive_sim.campaign.criteria import UNSTABLE, error_columns, rms
from adaptdrive_sim.campaign.drawn import Row
from adaptdrive_sim.plants.battery import Battery
from adaptdrive_sim.virtual import OperatedDrive
from adaptdrive_sim.world import World

Array = NDArray[np.float64]

_BEGINS_s = 60.0
_NEAR_LIMIT = 0.99
_LAST_PERIODS = 100


@dataclass(slots=True)
class BatteryRun:
    """Course of a run, an entry for each slow period, and the trip that ended it."""

    time_s: list[float] = field(default_factory=list)
    reference: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    terminal_V: list[float] = field(default_factory=list)
    adaptive: list[bool] = field(default_factory=list)
    reason: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    trip: str = ""


def run_battery(scenario: BatteryScenario, mode: Mode) -> BatteryRun:
    """Charge one battery."""
    plant = Battery(scenario.battery())
    drive = _started(scenario, World(plant, scenario.world()), mode)
    run, setpoint_A, series_Ohm = BatteryRun(), 0.0, plant.series_Ohm
    began_s = drive.time_s
    while (time_s := drive.time_s - began_s) < scenario.duration_s and not drive.completed:
        if drive.machine.trip is not None:
            run.trip = drive.machine.trip
            return run
        if scenario.setpoint_at(time_s) != setpoint_A:
            setpoint_A = scenario.setpoint_at(time_s)
            _ask(run, drive, setpoint_A)
        if drive.tick():
            plant.series_Ohm = series_Ohm * scenario.series_at(time_s)
            _note(run, drive, plant, time_s)
    return run


def _started(scenario: BatteryScenario, world: World, mode: Mode) -> OperatedDrive:
    """A drive that has just reached `running`."""
    drive = OperatedDrive(scenario.configuration(), world)
    drive.tick()
    drive.carry_out(Enable())
    while drive.machine.state is State.STARTING:
        drive.tick()
    drive.carry_out(SetMode(mode))
    return drive


def _ask(run: BatteryRun, drive: OperatedDrive, setpoint_A: float) -> None:
    """Ask for a current; one that is refused leaves the drive at the one before."""
    try:
        drive.carry_out(SetSetpoint(setpoint_A))
    except RefusedError as problem:
        run.refused.append(str(problem))


def _note(run: BatteryRun, drive: OperatedDrive, plant: Battery, time_s: float) -> None:
    """Keep what happened in a slow period; a ripple that is asked for is part of the reference."""
    decision = drive.decision
    if decision is None:
        return
    run.time_s.append(time_s)
    run.reference.append(drive.reference + float(np.nan_to_num(decision.probe)))
    run.output.append(plant.output)
    run.terminal_V.append(plant.terminal_voltage_V)
    run.adaptive.append(decision.controller is Mode.ADAPTIVE)
    run.reason.append(decision.reason)


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


def _judged(scenario: BatteryScenario, run: BatteryRun, name: str) -> Row:
    """Cost of one controller at constant current, over the step of the set-point."""
    errors = np.array([np.inf])
    if not run.trip:
        references, outputs = np.array(run.reference), np.array(run.output)
        pole = scenario.configuration().load.pole
        errors = (outputs - ideal_current(references, pole)) / scenario.step_A
        errors = errors[_constant(scenario, run)]
    if errors.size == 0:
        errors = np.zeros(1)  # at the voltage limit from the start: nothing is judged
    return error_columns(name, errors) | {
        f"unstable_{name}": not rms(errors[-_LAST_PERIODS:]) < UNSTABLE,
        f"interlock_{name}": int(bool(run.trip)),
        f"trip_{name}": run.trip,
        f"refused_{name}": len(run.refused),
    }


def _constant(scenario: BatteryScenario, run: BatteryRun) -> NDArray[np.bool_]:
    """Return the slow periods at constant current: from its start to the voltage limit."""
    near_V = _NEAR_LIMIT * CELL_FULL_V * scenario.cells
    reached = np.flatnonzero(np.array(run.terminal_V) >= near_V)
    end = reached[0] if reached.size else len(run.time_s)
    within: NDArray[np.bool_] = np.array(run.time_s) >= _BEGINS_s
    return within & (np.arange(len(run.time_s)) < end)


def _ripple(scenario: BatteryScenario, run: BatteryRun) -> Row:
    """Return the share of constant current with adaptive in force, and the ripple."""
    constant = _constant(scenario, run)
    if run.trip or not np.any(constant):
        return {"adaptive_share": 0.0, "ripple_found": float("nan"), "constant_s": 0.0}
    times_s = np.array(run.time_s)
    steady = constant & (times_s < 0.7 * scenario.duration_s)
    outputs = np.array(run.output)[steady]
    return {
        "adaptive_share": float(np.mean(np.array(run.adaptive)[constant])),
        "ripple_found": float(np.ptp(outputs) / scenario.current_A)
        if outputs.size
        else float("nan"),
        "constant_s": float(np.count_nonzero(constant)),
    }
