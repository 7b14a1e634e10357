"""Connection between the drive and its controller: rounding, a late sensor, interlocks.

Numbers on a bus are whole multiples of a quantum. The regulated output may come from a separate
sensor, some half cycles older than the drive's frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.signals import Measurement
from adaptdrive.control.vectors import Vector, shift_in

_WHOLE = 1.5 * 2.0**52
"""So large that a sum with it is a whole number: half the cost of `floor` in compiled code."""


DELAY_MAX = 20
"""Oldest output in half cycles."""


OVER_VOLTAGE = 1
OVER_OUTPUT = 2
NOT_FINITE = 3
CONTROL_FAULT = 4
"""The controller itself trips: the load does not respond, or the fixed law is in a limit cycle."""


@dataclass(slots=True)
class Wire:
    """Resolution and delay; a quantum of 0 does not round.

    Attributes:
        output_quantum: Of the output, in its unit.
        voltage_quantum_V: Of boost and line voltage.
        power_quantum_W: Of the load power.
        scale_quantum_S: Of the commanded current scale.
        output_delay: Age of the output in half cycles.
        outputs: The last outputs, newest first: as many as the delay needs.
    """

    output_quantum: float
    voltage_quantum_V: float
    power_quantum_W: float
    scale_quantum_S: float
    output_delay: int
    outputs: Vector


def perfect_wire(output: float) -> Wire:
    """One that neither rounds nor delays."""
    return Wire(0.0, 0.0, 0.0, 0.0, 0, [output] * (DELAY_MAX + 1))


def rounded(value: float, quantum: float) -> float:
    """The nearest multiple of a quantum, of two equally near ones the even one."""
    if quantum > 0.0:
        return quantum * ((value / quantum + _WHOLE) - _WHOLE)
    return value


def delayed(wire: Wire, output: float) -> float:
    """Return the output that arrives now, when `output` is measured."""
    shift_in(wire.outputs, output)
    return rounded(wire.outputs[wire.output_delay], wire.output_quantum)


def find_cause(measurement: Measurement, voltage_max_V: float, output_max: float) -> int:
    """The interlock that a measurement trips, or 0."""
    if measurement.boost_voltage_V > voltage_max_V:
        return OVER_VOLTAGE
    if measurement.output > output_max:
        return OVER_OUTPUT
    if not math.isfinite(measurement.boost_voltage_V + measurement.output):
        return NOT_FINITE
    return 0
