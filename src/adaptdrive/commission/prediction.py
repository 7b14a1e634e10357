"""Predicted response of the proposed loop: the daemon's controller on the identified load."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive.analysis.closed_loop import LoopStart, run_loop
from adaptdrive.analysis.steps import Quality, period_means, quality_of
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import tick_s
from adaptdrive.config.root import Configuration
from adaptdrive.control.load import Load, to_input, to_voltage
from adaptdrive.control.signals import Mode, Order, Stage
from adaptdrive.identification.response import held_step
from adaptdrive.identification.result import IdentifiedLoad

Array = NDArray[np.float64]

_PERIODS_BEFORE, _PERIODS_AFTER = 10, 60
_POWER_SHARE = 0.5
"""Power of the load at the highest V_c over the largest power of the drive."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """Response to one step of the set-point, as means over slow periods.

    Attributes:
        time_s: Middle of each slow period, from the step on.
        output: Output.
        boost_voltage_V: v_bst.
        quality: Overshoot, settling, effort.
    """

    time_s: Array
    output: Array
    boost_voltage_V: Array
    quality: Quality


class _Plant:
    """The identified load, at rest at a boost voltage."""

    def __init__(
        self, identified: IdentifiedLoad, load: Load, configuration: Configuration, rest_V: float
    ) -> None:
        self._load = load
        self._offset = identified.input_offset.value
        self._numerator = np.array(identified.numerator)
        self._denominator = np.array(identified.denominator)
        period_s = tick_s(configuration) * configuration.bus.ticks_per_reading
        self._transition, self._entry = held_step(self._denominator, period_s)
        limits = configuration.drive.limits
        self._power_W_per_V2 = (
            _POWER_SHARE * limits.load_power_max_W / limits.boost_reference_max_V**2
        )
        late = round(identified.delay_s / period_s)
        self._late = deque([self._input(rest_V)] * late)
        self._state = np.zeros(len(self._denominator) - 1)
        self._state[0] = self._input(rest_V) / self._denominator[-1]

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        """Advance by one reading of the drive."""
        del duration_s
        self._late.append(self._input(boost_voltage_V))
        fed = self._late.popleft()
        self._state = self._transition @ self._state + self._entry * fed
        direct = fed - self._denominator[:0:-1] @ self._state
        output = self._numerator[:0:-1] @ self._state + self._numerator[0] * direct
        return float(output), self._power_W_per_V2 * boost_voltage_V**2

    def _input(self, voltage_V: float) -> float:
        own = self._load
        return to_input(voltage_V, own.input_gain, own.input_exponent) + self._offset


def predict(
    identified: IdentifiedLoad, configuration: Configuration, rest_V: float, move: float
) -> Prediction:
    """Run the fixed controller on the identified load over a step of the set-point.

    Args:
        identified: The load.
        configuration: The proposed settings.
        rest_V: Boost voltage before the step.
        move: Size of the step.
    """
    load, section = build_load(configuration), configuration.load
    gain = identified.numerator[-1] / identified.denominator[-1]
    fed = to_input(rest_V, load.input_gain, load.input_exponent)
    rest = gain * (fed + identified.input_offset.value)
    samples = configuration.ticks_per_period // configuration.bus.ticks_per_reading
    first = _PERIODS_BEFORE * samples

    def order(number: int) -> Order:
        reference = rest if number < first else rest + move
        return Order(Stage.RUN, reference, Mode.FIXED, section.pole)

    count = (_PERIODS_BEFORE + _PERIODS_AFTER) * samples
    plant = _Plant(identified, load, configuration, rest_V)
    record = run_loop(configuration, plant, order, count, LoopStart(boost_voltage_V=rest_V))
    output = period_means(np.array(record.output), samples)
    volts = period_means(np.array(record.boost_voltage_V), samples)
    reference = np.where(np.arange(len(output)) < _PERIODS_BEFORE, rest, rest + move)
    span = section.reference_max - section.reference_min
    return Prediction(
        time_s=np.array(
            [(k + 0.5 - _PERIODS_BEFORE) * section.period_s for k in range(len(output))]
        ),
        output=output,
        boost_voltage_V=volts,
        quality=quality_of(reference, output, volts, section.period_s, span),
    )


def rest_voltage(outcome_low_V: float, outcome_high_V: float, load: Load) -> float:
    """Return the voltage in the middle between both levels of the test.

    Args:
        outcome_low_V: V_c at rest.
        outcome_high_V: The other level.
        load: Input map.
    """
    gain, exponent = load.input_gain, load.input_exponent
    ends = [to_input(one, gain, exponent) for one in (outcome_low_V, outcome_high_V)]
    return to_voltage(0.5 * sum(ends), gain, exponent)
