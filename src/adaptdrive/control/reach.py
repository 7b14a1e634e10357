"""The outputs that V_c can hold: where a model rests at the lowest and at the highest V_c.

    y = g (u + d)       u: the input at either limit of V_c, d: the estimated offset of the input

A load that stores nothing below its own voltage, a battery, has no negative output; where its EMF
is not known yet, the range is not known either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.load import Load, to_input
from adaptdrive.control.rest import believed_offset
from adaptdrive.control.settings import Learning, PowerStage
from adaptdrive.control.slow_state import SlowState
from adaptdrive.control.vectors import total


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
