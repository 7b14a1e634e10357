"""Attainable outputs: the steady states at the lowest and at the highest V_c.

A set-point at the edge of what the drive can do leaves the input at its limit for ever. That is no
trouble while the output rests where a model puts it,

    y = g (u + d)              d: the estimated offset of the input, a load torque for example

and a load that is on its way there is none either.

y = g (u + d)       u: the input at either limit of V_c, d: the estimated offset of the input

A load that stores nothing below its own voltage, a battery, has no negative output; where its EMF
is not known yet, the range is not known either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.loads.load import Load, to_input
from adaptdrive.control.settings import Learning, PowerStage
from adaptdrive.control.slow_state import SlowState
from adaptdrive.control.vectors import total

# Steady state of the load at a constant input, by the nominal and by the trusted model.


def distance_from_rest(learning: Learning, load: Load, state: SlowState, output: float) -> float:
    """Return how far the output is from the nearest place where a model rests at this input.

    Args:
        learning: Scales, and whether an offset is estimated.
        load: The nominal model.
        state: The input in force, the last trusted model, and the estimate.
        output: y[k].
    """
    offset = believed_offset(learning, load, state)
    distance = _distance(load, load.gain, state.sent, offset, output)
    if state.supervisor.trusted:
        gain = total(state.trusted_b) / total(state.trusted_a)
        distance = min(distance, _distance(load, gain, state.sent, offset, output))
    return distance


def believed_offset(learning: Learning, load: Load, state: SlowState) -> float:
    """Return the estimated offset of the input, 0 where none is estimated.

    Args:
        learning: Scales, and whether an offset is estimated.
        load: The nominal model.
        state: The estimate.
    """
    estimator = state.estimator
    if not (estimator.method.physical and learning.bias):
        return 0.0
    estimated = estimator.method.input_offset(estimator, learning, load)
    return estimated if math.isfinite(estimated) else 0.0


def _distance(load: Load, gain: float, held: float, offset: float, output: float) -> float:
    """Distance from g·u or from g·(u + d), the nearer; a battery takes no negative current."""
    plain, shifted = load.possible(gain * held), load.possible(gain * (held + offset))
    return min(abs(output - plain), abs(output - shifted))


# The outputs that V_c can hold: where a model rests at the lowest and at the highest V_c.


@dataclass(frozen=True, slots=True)
class Reach:
    """Reachable range of the output; NaN for an end that is not known.

    Attributes:
        low: Output at rest at the lowest V_c.
        high: Output at rest at the highest V_c.
    """

    low: float = math.nan
    high: float = math.nan

    @property
    def is_known(self) -> bool:
        """True where both ends are known."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def holds(self, value: float) -> bool:
        """Return whether V_c can hold an output; True while the range is not known."""
        return not (value < self.low or value > self.high)

    def nearest(self, value: float) -> float:
        """Return the output within reach that is nearest; the same while the range is not known."""
        if value > self.high:
            return self.high
        return max(value, self.low)


UNKNOWN = Reach()
"""Reach of a load of which not enough is known."""


def nominal_reach(load: Load, stage: PowerStage) -> Reach:
    """Return what V_c reaches with the nominal load; not known for a battery, whose EMF is not.

    Args:
        load: The load.
        stage: Limits of V_c.
    """
    if load.charging is not None:
        return UNKNOWN
    return _reach(load, stage, load.gain, 0.0)


def estimated_reach(learning: Learning, load: Load, stage: PowerStage, state: SlowState) -> Reach:
    """Return what V_c reaches with the last trusted model and the present offset.

    Args:
        learning: Scales, and whether an offset is estimated.
        load: The load.
        stage: Limits of V_c.
        state: An estimate that is trusted now.
    """
    gain = total(state.trusted_b) / total(state.trusted_a)
    return _reach(load, stage, gain, believed_offset(learning, load, state))


def _reach(load: Load, stage: PowerStage, gain: float, offset: float) -> Reach:
    scale, exponent = load.input_gain, load.input_exponent
    low = gain * (to_input(stage.boost_reference_min_V, scale, exponent) + offset)
    high = gain * (to_input(stage.boost_reference_max_V, scale, exponent) + offset)
    return Reach(_shown(load.possible(low)), _shown(load.possible(high)))


def _shown(value: float) -> float:
    """Return a value as it is shown, with three digits: what is shown is what is accepted."""
    return float(f"{value:.3g}")
