"""A course of references and loads, and the run of the deployed controller over it.

This is the interpreted runner; `compiled.run` runs the same course on compiled code.
"""

from __future__ import annotations

import dataclasses
import math
from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.controller import Controller
from adaptdrive.control.settings import Rates
from adaptdrive.control.signals import Decision, Measurement, Mode, Order, Snapshot, Stage
from adaptdrive_sim.compiled.wire import CONTROL_FAULT, Wire, find_cause
from adaptdrive_sim.virtual import VirtualDrive
from adaptdrive_sim.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TripLevels:
    """Trip levels that matter without a bus."""

    boost_voltage_max_V: float = math.inf
    output_max: float = math.inf


@dataclass(frozen=True, slots=True)
class Course:
    """Events in the course of a run.

    Attributes:
        references: r[k].
        sizes: Size that the load is to have in each slow period, as a multiple of the nominal one.
        over_s: How long a change of it takes.
        disturbances: Measurement noise of every tick, and of one more.
        mode: Controller asked for.
        pole: Closed-loop pole.
        wire: Resolution and delay between drive and controller, None for neither.
        interlocks: What ends the run early.
        burdens: What the load is disturbed by in each slow period, as its `disturb` takes it:
            torque in N m, or an inflow relative to that at the start. Empty for nothing.
        offset: What the sensor of the output shows beside the output.
        stops: Slow periods in which the drive is off; it precharges in the last of each. Compiled
            code knows no stops.
        steady: Whether the reference counts as a constant set-point, which may be probed.
    """

    references: Array
    sizes: Array
    over_s: float
    disturbances: Array
    mode: Mode
    pole: float
    wire: Wire | None = None
    interlocks: TripLevels = field(default_factory=TripLevels)
    burdens: Array = field(default_factory=lambda: np.empty(0))
    offset: float = 0.0
    stops: tuple[range, ...] = ()
    steady: bool = False

    def stage(self, k: int) -> Stage:
        """Return what the drive is to do in a slow period."""
        stop = next((one for one in self.stops if k in one), None)
        if stop is None:
            return Stage.RUN
        return Stage.PRECHARGE if k == stop[-1] else Stage.OFF


@dataclass(slots=True)
class Run:
    """Record of a run: one entry for each slow period, taken at its first tick.

    Attributes:
        periods: Slow periods in which the drive ran.
        outputs: Output without noise.
        snapshots: What the slow half was given.
        decisions: What it made of that.
        verdicts: Of the supervisor.
        fallbacks: Of the watch, 0 for none.
        interlock: What ended the run, 0 for nothing.
        fast_output: Output without noise at every tick, where asked for.
        fast_voltage_V: Boost voltage at every tick, where asked for.
    """

    periods: list[int] = field(default_factory=list)
    outputs: list[float] = field(default_factory=list)
    snapshots: list[Snapshot] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    verdicts: list[int] = field(default_factory=list)
    fallbacks: list[int] = field(default_factory=list)
    interlock: int = 0
    fast_output: array[float] = field(default_factory=lambda: array("d"))
    fast_voltage_V: array[float] = field(default_factory=lambda: array("d"))


def start_at_rest(controller: Controller, world: World, course: Course, output: float) -> None:
    """Put a plant at rest where its sensor shows an output, and start a controller on it.

    A line with a higher peak than that output needs lets the plant rest above it.
    """
    boost, line = world.boost, world.line
    rest = output - course.offset
    needed_V, peak_V = world.boost_voltage_for(rest), line.voltage_V * 2.0**0.5
    world.settle(max(needed_V, peak_V))
    if needed_V < peak_V:
        output = world.true_output + course.offset
    at_rest = Measurement(
        -1, line.half_cycle_s, boost.voltage_V, line.voltage_V, boost.mean_load_W, output
    )
    controller.tick(at_rest, Order(Stage.RUN, output, course.mode, course.pole))


def run_course(
    controller: Controller, world: World, course: Course, rates: Rates, *, keep_ticks: bool = False
) -> Run:
    """Run a controller that was started on a plant at rest.

    Args:
        controller: The deployed controller.
        world: The plant; its load changes with the course.
        course: What happens.
        rates: Q and L.
        keep_ticks: Whether output and boost voltage of every tick are to be kept.
    """
    run, ticks, disturbances = Run(), rates.ticks_per_period, course.disturbances.tolist()
    first = world.step_disturbed(world.current_scale_S, world.bridge, disturbances[0])
    drive = VirtualDrive(controller, rates.latency_ticks, world, first, course.wire)
    voltage_max_V, output_max = dataclasses.astuple(course.interlocks)
    load: Any = world.load
    burdens = course.burdens.tolist()
    for k, reference in enumerate(course.references.tolist()):
        if k > 0 and course.sizes[k] != course.sizes[k - 1]:
            load.resize(float(course.sizes[k]), course.over_s)
        if len(burdens) and (k == 0 or burdens[k] != burdens[k - 1]):
            load.disturb(burdens[k])
        order = Order(course.stage(k), reference, course.mode, course.pole, steady=course.steady)
        for n in range(k * ticks, (k + 1) * ticks):
            measurement = drive.measure(n)
            run.interlock = find_cause(measurement, voltage_max_V, output_max)
            if run.interlock:
                return run
            if keep_ticks:
                run.fast_output.append(load.output)
                run.fast_voltage_V.append(measurement.boost_voltage_V)
            command, decided = drive.control(measurement, order)
            if decided:
                run.periods.append(k)
                _note(run, drive, controller)
                if run.decisions[-1].fault:
                    run.interlock = CONTROL_FAULT
                    return run
            drive.advance(command, disturbances[n + 1])
    return run


def _note(run: Run, drive: VirtualDrive, controller: Controller) -> None:
    """Keep what happened in a slow period."""
    if drive.snapshot is None or drive.decision is None:
        return
    run.outputs.append(drive.world.true_output)
    run.snapshots.append(drive.snapshot)
    run.decisions.append(drive.decision)
    run.verdicts.append(controller._slow.supervisor.verdict)  # noqa: SLF001  # as a number
    run.fallbacks.append(controller._slow.watch.fallback)  # noqa: SLF001  # as a number
