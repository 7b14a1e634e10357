"""Between the drive and its controller: rounding, a late sensor, interlocks.

Numbers on a bus are whole multiples of a quantum. The regulated output may come from a separate
sensor, some half cycles older than the drive's frame.
"""

import math
from dataclasses import dataclass

from adaptdrive.control.signals import Measurement
from adaptdrive.control.vectors import Vector, shift_in
from adaptdrive_sim.plants.boost import Sample

_WHOLE = 1.5 * 2.0**52
"""So large that a sum with it is a whole number: cheaper than `floor`."""


OVER_VOLTAGE = 1
OVER_OUTPUT = 2
NOT_FINITE = 3
CONTROL_FAULT = 4
"""The controller itself trips: the load does not respond, or the fixed law is in a limit cycle."""


@dataclass(slots=True)
class Wire:
    """Resolution and delay; a quantum of 0 does not round.

    Attributes:
        outputs: The last outputs, newest first: one more than half cycles that the output is late.
        output_quantum: Of the output, in its unit.
        voltage_quantum_V: Of boost and line voltage.
        power_quantum_W: Of the load power.
        scale_quantum_S: Of the commanded current scale.
    """

    outputs: Vector
    output_quantum: float = 0.0
    voltage_quantum_V: float = 0.0
    power_quantum_W: float = 0.0
    scale_quantum_S: float = 0.0


def received(wire: Wire, tick: int, sample: Sample) -> Measurement:
    """Return what arrives at a tick of what the drive measures now."""
    shift_in(wire.outputs, sample.output)
    boost_V = rounded(sample.boost_voltage_V, wire.voltage_quantum_V)
    line_V = rounded(sample.line_voltage_V, wire.voltage_quantum_V)
    load_W = rounded(sample.load_power_W, wire.power_quantum_W)
    output = rounded(wire.outputs[-1], wire.output_quantum)
    return Measurement(tick, sample.tick_period_s, boost_V, line_V, load_W, output)


def rounded(value: float, quantum: float) -> float:
    """The nearest multiple of a quantum, of two equally near ones the even one."""
    if quantum > 0.0:
        return quantum * ((value / quantum + _WHOLE) - _WHOLE)
    return value


def find_cause(measurement: Measurement, voltage_max_V: float, output_max: float) -> int:
    """The interlock that a measurement trips, or 0."""
    if measurement.boost_voltage_V > voltage_max_V:
        return OVER_VOLTAGE
    if measurement.output > output_max:
        return OVER_OUTPUT
    if not math.isfinite(measurement.boost_voltage_V + measurement.output):
        return NOT_FINITE
    return 0
