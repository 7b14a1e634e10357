"""The watch over the fixed controller: a limit cycle ends in the safe state.

A fixed controller on a load far from its model can drive the input from one limit to the other for
ever. Noise does that too, and so do set-points that change; a limit cycle differs from them by a
set-point that rests, and by an estimate that predicts the movements of the load far better than the
model. A constant error of the model does not count: the integrator removes it, and noise that moves
the input from limit to limit would otherwise trip a healthy drive whose model is a little wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.evidence import MEMORY

TRAVERSES = MEMORY
"""Ways of the input from one limit to the other that are a limit cycle, each of one slow period or
more: all that an estimate remembers is the cycle then, the adaptive controller has taken over where
the estimate is within its bounds, and the mean errors have forgotten the last step."""

LONGEST_WAY = MEMORY
"""Slow periods after which a way belongs to no cycle: the one before is forgotten by then."""

AT_LIMIT = 0.1
"""Distance from a limit, as a share of the range of the input, that counts as at the limit."""

FAR_BETTER = 3.0
"""Ratio of rms prediction errors, model over estimate, that contradicts model and bounds."""


@dataclass(slots=True)
class CyclingState:
    """State of the watch.

    Attributes:
        side: Limit at which the input was last: -1, 1, or 0 for none yet.
        traverses: Ways from limit to limit in a row.
        way_periods: Slow periods since the input was last at that limit.
        reference: Set-point at which the count began.
    """

    side: int = 0
    traverses: int = 0
    way_periods: int = 0
    reference: float = 0.0


def watch_cycling(
    state: CyclingState,
    position: float,
    reference: float,
    reference_step: float,
    better: float,
    fixed: bool,
) -> bool:
    """Check one slow period; True for a limit cycle.

    Args:
        state: Overwritten.
        position: Input in force, 0 at its lowest and 1 at its highest.
        reference: r.
        reference_step: Smallest change of it that begins the count anew; infinite for no watch.
        better: Rms prediction error of the model, its mean left out, over that of the estimate.
        fixed: Whether the fixed controller is in force.
    """
    if math.isinf(reference_step):
        return False
    if not fixed or abs(reference - state.reference) > reference_step:
        state.side = state.traverses = 0
        state.reference = reference
    state.way_periods += 1
    side = 1 if position >= 1.0 - AT_LIMIT else -1 if position <= AT_LIMIT else 0
    if side != 0:
        _arrive(state, side)
    return fixed and state.traverses >= TRAVERSES and better > FAR_BETTER


def _arrive(state: CyclingState, side: int) -> None:
    """Count a way that has ended at a limit."""
    if state.way_periods > LONGEST_WAY:
        state.traverses = 0
    elif side == -state.side:
        state.traverses += 1
    state.side, state.way_periods = side, 0
