"""Predicted response of the proposed loop: the daemon's controller on the identified load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive.analysis.closed_loop import LoopStart, run_loop
from adaptdrive.analysis.identified_plant import IdentifiedPlant
from adaptdrive.analysis.steps import Quality, period_means, quality_of
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import tick_s
from adaptdrive.config.root import Configuration
from adaptdrive.control.load import Load, to_input, to_voltage
from adaptdrive.control.signals import Mode, Order, Stage
from adaptdrive.identification.result import IdentifiedLoad

Array = NDArray[np.float64]

_PERIODS_BEFORE, _PERIODS_AFTER = 10, 60
_SETTLED = 10.0
"""Slow periods after the step over the time constant of the pole, 1 / (1 - pole), at least."""

_UNSEEN = 0.01
"""Overshoot, as a share of the step, that no present settings are compared with."""

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
        fault: Cause that ended it early, empty for none.
    """

    time_s: Array
    output: Array
    boost_voltage_V: Array
    quality: Quality
    fault: str = ""

    def refusal(self, present: Prediction) -> str:
        """Return why the settings are not to be put to use, empty where they are.

        Args:
            present: The prediction with the settings in force.
        """
        overshoot, settling_s = self.quality.overshoot, self.quality.settling_s
        if self.fault:
            return f"the predicted loop trips: {self.fault}"
        shown = f"predicted overshoot {100.0 * overshoot:.1f} %"
        if not (math.isfinite(overshoot) and math.isfinite(settling_s)):
            return f"the loop does not settle: {shown}, settling {settling_s:.4g} s"
        before = present.quality.overshoot
        if overshoot > _UNSEEN and overshoot > before:
            return f"{shown}, with the present settings {100.0 * before:.1f} %"
        return ""


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

    after = max(_PERIODS_AFTER, math.ceil(_SETTLED / (1.0 - section.pole)))
    count = (_PERIODS_BEFORE + after) * samples
    period_s = tick_s(configuration) * configuration.bus.ticks_per_reading
    plant = IdentifiedPlant(identified, load, period_s, (rest_V, rest), _power(configuration))
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
        fault=record.fault,
    )


def _power(configuration: Configuration) -> Array:
    """Return the factors of v², v and v·y in the power of the load."""
    limits = configuration.drive.limits
    return np.array(
        [_POWER_SHARE * limits.load_power_max_W / limits.boost_reference_max_V**2, 0.0, 0.0]
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
