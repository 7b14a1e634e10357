"""Steady state of the load at a constant input, by the nominal and by the trusted model.

A set-point at the edge of what the drive can do leaves the input at its limit for ever. That is no
trouble while the output rests where a model puts it,

    y = g (u + d)              d: the estimated offset of the input, a load torque for example

and a load that is on its way there is none either.
"""

from __future__ import annotations

import math

from adaptdrive.control.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.slow_state import SlowState
from adaptdrive.control.vectors import total


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
    if not (learning.method.physical and learning.bias):
        return 0.0
    estimated = learning.method.input_offset(state.estimator, learning, load)
    return estimated if math.isfinite(estimated) else 0.0


def _distance(load: Load, gain: float, held: float, offset: float, output: float) -> float:
    """Distance from g·u or from g·(u + d), the nearer; a battery takes no negative current."""
    plain, shifted = load.possible(gain * held), load.possible(gain * (held + offset))
    return min(abs(output - plain), abs(output - shifted))
