"""The load of a recorded session as a plant, with the disturbances of the record."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from adaptdrive.analysis.excerpts import Stretch
from adaptdrive.control.load import Load, to_input
from adaptdrive.identification.response import held_step
from adaptdrive.identification.result import IdentifiedLoad

Array = NDArray[np.float64]


class IdentifiedPlant:
    """An identified load behind the boost capacitor; it begins at rest.

    Attributes:
        disturbance: What is added to the output of each step, 0 after its end.
    """

    def __init__(
        self,
        load: IdentifiedLoad,
        structure: Load,
        period_s: float,
        rest: tuple[float, float],
        power: Array,
    ) -> None:
        """Put a load at rest.

        Args:
            load: The load.
            structure: Its input map.
            period_s: Length of each step.
            rest: Boost voltage and output at rest.
            power: Factors of v², v and v·y in the power that it draws.
        """
        self.disturbance = np.zeros(0)
        self._steps = 0
        self._structure, self._power = structure, power
        self._denominator, self._numerator = np.array(load.denominator), np.array(load.numerator)
        self._offset = load.input_offset.value
        self._transition, self._entry = held_step(self._denominator, period_s)
        rest_V, self._output = rest
        self._late = deque([self._input(rest_V)] * round(load.delay_s / period_s))
        self._state = np.zeros(len(self._denominator) - 1)
        self._state[0] = self._output / self._numerator[-1]

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance by one step, whatever its duration."""
        del duration_s
        self._late.append(self._input(boost_voltage_V))
        load_input = self._late.popleft()
        power_W = max(0.0, float(_power_terms(boost_voltage_V, self._output) @ self._power))
        self._state = self._transition @ self._state + self._entry * load_input
        direct, slope = self._numerator[0], self._numerator[:0:-1]
        fed = load_input - self._denominator[:0:-1] @ self._state
        self._output = float(slope @ self._state + direct * fed)
        disturbed = self._output
        if self._steps < len(self.disturbance):
            disturbed += float(self.disturbance[self._steps])
        self._steps += 1
        return disturbed, power_W

    def _input(self, boost_voltage_V: float) -> float:
        own = self._structure
        return to_input(boost_voltage_V, own.input_gain, own.input_exponent) + self._offset


def _power_law(stretch: Stretch) -> Array:
    """Return the factors of v², v and v·y that fit the recorded power best.

    Behind the dc/dc stage a load draws the current (N2 v - E)/R with E a constant, as that of a
    battery, or proportional to the output, as that of a motor.
    """
    columns = stretch.columns
    volts, outputs = columns["boost_voltage_V"], columns["output"]
    rows = np.column_stack((volts**2, volts, volts * outputs))
    lengths = np.linalg.norm(rows, axis=0)
    lengths[lengths == 0.0] = 1.0
    found: Array = np.linalg.lstsq(rows / lengths, columns["load_power_W"])[0] / lengths
    return found


def disturbed_plant(load: IdentifiedLoad, structure: Load, stretch: Stretch) -> IdentifiedPlant:
    """Return the plant with what the record has besides its response to the recorded voltage.

    Noise, torques, and the error of the model: fed with the recorded voltage it gives the record.
    """
    volts, output = stretch.columns["boost_voltage_V"], stretch.columns["output"]
    rest, power = (float(volts[0]), float(output[0])), _power_law(stretch)
    plant, made = (
        IdentifiedPlant(load, structure, stretch.period_s, rest, power) for _ in range(2)
    )
    means = np.concatenate((volts[:1], 0.5 * (volts[:-1] + volts[1:])))
    simulated = [plant.step(volt, stretch.period_s)[0] for volt in means.tolist()]
    made.disturbance = output - np.array(simulated)
    return made


def _power_terms(volts: float, output: float) -> Array:
    return np.array([volts**2, volts, volts * output])
