"""One experiment from start to end: the order of calls is the daemon's own.

A frame, a tick of the controller, at n = kQ the slow half, at n = kQ + L its decision takes
effect. This module is only ever run compiled; what it calls is the source of controller and
plant.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control import fast_half as fast
from adaptdrive.control.discretise import held_model
from adaptdrive.control.load import Load, to_input, to_voltage
from adaptdrive.control.pole_placement import desired_polynomial
from adaptdrive.control.settings import ControllerSettings, Learning
from adaptdrive.control.signals import Measurement
from adaptdrive.control.slow_half import slow_step
from adaptdrive.control.slow_state import SlowSample, SlowState
from adaptdrive.control.vectors import Vector, copy_into, total
from adaptdrive_sim.compiled.room import forget_vectors
from adaptdrive_sim.compiled.wire import CONTROL_FAULT, Wire, delayed, find_cause, rounded
from adaptdrive_sim.world import Sample, World

OUTPUT = 0
MEASURED = 1
REFERENCE_V = 2
APPLIED_V = 3
ADAPTIVE = 4
ACCEPTED = 5
VERDICT = 6
INNOVATION = 7
HANDOVER_V = 8
FALLBACK = 9
VALUES = 10

Array = NDArray[np.float64]


def run(
    settings: ControllerSettings,
    load: Load,
    state: fast.FastState,
    bank: fast.FilterBank,
    slow: SlowState,
    world: World,
    wire: Wire,
    measurement: Measurement,
    sample: SlowSample,
    references: Array,
    disturbances: Array,
    sizes: Array,
    over_s: float,
    burdens: Array,
    voltage_max_V: float,
    output_max: float,
    trace: Array,
) -> int:
    """Run an experiment on a controller that has just been started at rest.

    Args:
        settings: Settings of the controller.
        load: Its nominal load.
        state: Its fast half, overwritten.
        bank: Its filters, overwritten.
        slow: Its slow half, overwritten.
        world: The plant at rest, overwritten.
        wire: Resolution and delay.
        measurement: Room for the present one.
        sample: Room for the present one; its mode, pole and limits are used.
        references: r[k].
        disturbances: Measurement noise of every tick.
        sizes: Size of the load in each slow period, the first of which it has.
        over_s: How long a change of it takes.
        burdens: What disturbs it in each slow period; empty for nothing.
        voltage_max_V: Interlock.
        output_max: Interlock.
        trace: What happened, one row for each slow period, overwritten.

    Returns:
        0, or the interlock that ended the run.
    """
    rates, stage = settings.rates, settings.stage
    ticks, latency = rates.ticks_per_period, rates.latency_ticks
    decided_V = state.boost_reference_V
    scale_S = world.current_scale_S
    frame = world.step_disturbed(scale_S, True, disturbances[0])
    for k in range(len(references)):
        change_plant(world.load, k, sizes, over_s, burdens)
        for into in range(ticks):
            n = k * ticks + into
            receive(measurement, wire, n, frame)
            cause = find_cause(measurement, voltage_max_V, output_max)
            if cause:
                return cause
            if into == latency:
                state.boost_reference_V = decided_V
            if fast.take_in(settings, load, state, bank, measurement):
                trace[k, OUTPUT] = world.load.output
                sample.reference = references[k]
                for i in range(len(sample.upcoming)):
                    sample.upcoming[i] = references[min(k + 1 + i, len(references) - 1)]
                decided_V = decide(settings, load, state, bank, slow, measurement, sample)
                note(trace[k], slow, sample, decided_V, settings.learning, load)
                if slow.unresponsive or slow.cycling:
                    return CONTROL_FAULT
            scale_S = fast.drive(state, stage, measurement)[0]
            scale_S = rounded(scale_S, wire.scale_quantum_S)
            frame = world.step_disturbed(scale_S, True, disturbances[n + 1])
    return 0


def hold(
    settings: ControllerSettings,
    load: Load,
    state: fast.FastState,
    bank: fast.FilterBank,
    world: World,
    wire: Wire,
    measurement: Measurement,
    disturbances: Array,
    sizes: Array,
    over_s: float,
    burdens: Array,
    k: int,
    decided_V: float,
    found: Array,
) -> None:
    """Run slow period k on a V_c that somebody else has decided, up to the snapshot after it.

    Args:
        settings: Settings of the controller, whose fast half runs.
        load: Its nominal load.
        state: Its fast half, overwritten.
        bank: Its filters, overwritten.
        world: The plant, overwritten.
        wire: Resolution and delay.
        measurement: The present one, overwritten.
        disturbances: Measurement noise of every tick.
        sizes: Size of the load in each slow period, the first of which it has.
        over_s: How long a change of it takes.
        burdens: What disturbs it in each slow period; empty for nothing.
        k: Slow period; -1 for the tick before the first one.
        decided_V: V_c, in force after the latency.
        found: Output, its mean over the window and the mean applied V_c, overwritten.
    """
    forget_vectors()
    ticks, latency = settings.rates.ticks_per_period, settings.rates.latency_ticks
    if k >= 0:
        change_plant(world.load, k, sizes, over_s, burdens)
    for into in range(ticks - 1 if k < 0 else 0, ticks):
        n = k * ticks + into
        if into == latency:
            state.boost_reference_V = decided_V
        scale_S = world.current_scale_S
        if k >= 0:
            scale_S = fast.drive(state, settings.stage, measurement)[0]
            scale_S = rounded(scale_S, wire.scale_quantum_S)
        receive(measurement, wire, n + 1, world.step_disturbed(scale_S, True, disturbances[n + 1]))
        fast.take_in(settings, load, state, bank, measurement)
    found[0], found[1] = world.load.output, fast.take_means(bank)[0]
    found[2] = fast.close_period(state, settings)[0]


def change_plant(plant: Any, k: int, sizes: Array, over_s: float, burdens: Array) -> None:
    """Change the size of the load and what disturbs it, where slow period k has other ones."""
    if k > 0 and sizes[k] != sizes[k - 1]:
        plant.resize(sizes[k], over_s)
    if len(burdens) > 0 and (k == 0 or burdens[k] != burdens[k - 1]):
        plant.disturb(burdens[k])


def receive(measurement: Any, wire: Wire, tick: int, frame: Sample) -> None:
    """Overwrite the measurement by what the drive measures now."""
    measurement.tick = tick
    measurement.tick_period_s = frame.tick_period_s
    measurement.boost_voltage_V = rounded(frame.boost_voltage_V, wire.voltage_quantum_V)
    measurement.line_voltage_V = rounded(frame.line_voltage_V, wire.voltage_quantum_V)
    measurement.load_power_W = rounded(frame.load_power_W, wire.power_quantum_W)
    measurement.output = delayed(wire, frame.output)


def decide(
    settings: ControllerSettings,
    load: Load,
    state: fast.FastState,
    bank: fast.FilterBank,
    slow: SlowState,
    measurement: Measurement,
    sample: SlowSample,
) -> float:
    """The slow half, from the end of the slow period to V_c."""
    forget_vectors()
    rates, order = settings.rates, load.order
    means = fast.take_means(bank)
    applied_V, followed, held = fast.close_period(state, settings)
    sample.rounding = fast.take_rounding(settings, bank)[1]
    fast.tune_filters(bank, measurement.tick_period_s, settings.learning.tau_lambda_s)
    sample.period_s = rates.ticks_per_period * measurement.tick_period_s
    sample.output = means[0]
    sample.output_filtered = means[1 : order + 1]
    sample.input_filtered = means[order + 1 :]
    sample.applied = to_input(applied_V, load.input_gain, load.input_exponent)
    sample.followed = followed
    sample.held_share = held / rates.ticks_per_period
    load_input = slow_step(settings, load, slow, sample)
    return to_voltage(load_input, load.input_gain, load.input_exponent)


def note(
    row: Array,
    slow: SlowState,
    sample: SlowSample,
    decided_V: float,
    learning: Learning,
    load: Load,
) -> None:
    """Keep what happened in a slow period."""
    row[MEASURED] = sample.output
    row[REFERENCE_V] = decided_V
    row[APPLIED_V] = to_voltage(sample.applied, load.input_gain, load.input_exponent)
    row[ADAPTIVE] = slow.adaptive
    row[ACCEPTED] = slow.accepted
    row[VERDICT] = slow.supervisor.verdict
    row[INNOVATION] = slow.estimator.innovation
    row[HANDOVER_V] = slow.handover_step
    row[FALLBACK] = slow.watch.fallback
    count = len(slow.values)
    deviations = shown_deviations(learning, load, slow)
    for i in range(count):
        row[VALUES + i] = slow.values[i]
        row[VALUES + count + i] = deviations[i]


def shown_deviations(learning: Learning, load: Load, slow: SlowState) -> Vector:
    """Return the standard deviations that a decision shows; NaN where there is no estimate."""
    if not math.isfinite(slow.values[0]):
        return [math.nan] * len(slow.values)
    return learning.method.shown_deviations(slow.estimator, learning, load, slow.values)


def follow_ideal(
    references: Array, numerators: Array, denominators: Array, pole: float, period_s: float
) -> Array:
    """Output of the loop as it was designed: true load, no limits, delays or noise.

    Args:
        references: r[k].
        numerators: Of the true load in each slow period.
        denominators: Likewise.
        pole: Closed-loop pole.
        period_s: T_k.

    Returns:
        y[k], from rest on the first reference.
    """
    order = denominators.shape[1] - 1
    forget_vectors()
    desired: Any = np.zeros(2 * order + 1)
    weights = desired
    copy_into(desired, desired_polynomial(pole, 2 * order))
    outputs = np.zeros(len(references))
    for k in range(len(references)):
        if k == 0 or changed(denominators, k) or changed(numerators, k):
            weights = ideal_weights(numerators[k], denominators[k], desired, period_s)
        for i in range(min(k + 1, len(weights))):
            outputs[k] += weights[i] * (references[k - i] - references[0])
        for i in range(1, min(k + 1, len(desired))):
            outputs[k] -= desired[i] * outputs[k - i]
    outputs += references[0]
    return outputs


def ideal_weights(numerator: Array, denominator: Array, desired: Any, period_s: float) -> Array:
    """A_m(1)/B(1) · B."""
    forget_vectors()
    _, b = held_model(list(numerator), list(denominator), period_s, 0.0, 0.0)
    scale, weights = total(desired) / total(b), np.empty(len(b))
    for i in range(len(b)):
        weights[i] = b[i] * scale
    return weights


def changed(rows: Array, k: int) -> bool:
    """Return whether a row differs from the one before."""
    for i in range(rows.shape[1]):
        if rows[k, i] != rows[k - 1, i]:
            return True
    return False
