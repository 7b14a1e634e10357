"""The same experiment on the deployed controller itself, interpreted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Decision, Measurement, Mode, Order, Stage
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.course import Course, Interlocks
from adaptdrive_sim.compiled.wire import Wire, delayed, rounded
from adaptdrive_sim.plants.motor import Motor
from adaptdrive_sim.world import Sample, World

Array = NDArray[np.float64]


def start_at_rest(controller: Controller, world: World, course: Course, output: float) -> None:
    """Start a controller on a plant that rests at an output."""
    at_rest = Measurement(
        tick=-1,
        tick_period_s=world.line.half_cycle_s,
        boost_voltage_V=world.boost.voltage_V,
        line_voltage_V=world.line.voltage_V,
        load_power_W=world.boost.mean_load_W,
        output=output,
    )
    controller.tick(at_rest, Order(Stage.RUN, output, course.mode, course.pole))


def run_deployed(  # mirrors the compiled one
    controller: Controller,
    motor: Motor,
    world: World,
    wire: Wire,
    course: Course,
    interlocks: Interlocks,
    ticks: int,
    latency: int,
) -> tuple[Array, int, list[Decision]]:
    """Run a controller that was started on a plant at rest.

    Returns:
        What happened, a row of `bench` columns for each slow period; the interlock that ended it
        or 0; and the decisions.
    """
    decisions: list[Decision] = []
    trace = np.full((len(course.references), bench.VALUES + 3), np.nan)
    disturbances = course.disturbances.tolist()
    frame = world.step_disturbed(world.current_scale_S, True, disturbances[0])
    for k, reference in enumerate(course.references.tolist()):
        if k > 0 and course.sizes[k] != course.sizes[k - 1]:
            motor.resize(float(course.sizes[k]), course.over_s)
        order = Order(Stage.RUN, reference, course.mode, course.pole)
        for n in range(k * ticks, (k + 1) * ticks):
            measurement = _received(wire, n, frame)
            cause = _find_cause(measurement, interlocks)
            if cause:
                return trace, cause, decisions
            if n == k * ticks + latency:
                controller.apply(decisions[-1])
            command = controller.tick(measurement, order)
            if n == k * ticks:
                trace[k, bench.OUTPUT] = motor.output
                decisions.append(_decide(controller, trace[k]))
            scale_S = rounded(command.current_scale_S, wire.scale_quantum_S)
            frame = world.step_disturbed(scale_S, command.bridge, disturbances[n + 1])
    return trace, 0, decisions


def _received(wire: Wire, tick: int, frame: Sample) -> Measurement:
    return Measurement(
        tick,
        frame.tick_period_s,
        rounded(frame.boost_voltage_V, wire.voltage_quantum_V),
        rounded(frame.line_voltage_V, wire.voltage_quantum_V),
        rounded(frame.load_power_W, wire.power_quantum_W),
        delayed(wire, frame.output),
    )


def _find_cause(measurement: Measurement, interlocks: Interlocks) -> int:
    return bench.find_cause(measurement, interlocks.boost_voltage_max_V, interlocks.output_max)


def _decide(controller: Controller, row: Array) -> Decision:
    snapshot = controller.take_snapshot()
    if snapshot is None:
        raise RuntimeError("the controller took no snapshot at the start of a slow period")
    decision = controller.decide(snapshot)
    row[bench.MEASURED] = snapshot.output
    row[bench.REFERENCE_V] = decision.boost_reference_V
    row[bench.APPLIED_V] = snapshot.applied_V
    row[bench.ADAPTIVE] = decision.controller is Mode.ADAPTIVE
    row[bench.ACCEPTED] = decision.accepted
    row[bench.VERDICT] = controller._slow.supervisor.verdict  # noqa: SLF001  # as a number
    row[bench.INNOVATION] = decision.innovation
    row[bench.HANDOVER_V] = decision.handover_step_V
    values = controller._slow.values  # noqa: SLF001  # also while they are withheld
    row[bench.VALUES : bench.VALUES + len(values)] = values
    return decision
