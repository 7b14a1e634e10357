"""Ringing: an input that swings to and fro, further than the noise of the output moves it.

Gains for a heavy load make the loop with a much lighter one unstable: it swings, with periods of a
few samples, and the swings grow tenfold within ten of them. That is sooner than an estimate can
follow. A step of the reference causes three swings at most, between the limits of the input: the
first of them does not count.
"""

from __future__ import annotations

from dataclasses import dataclass

SWINGS = 3
"""Swings in a row: noise has three tall ones once in a day of seconds."""

QUICK = 6
"""Longest swing, half a cycle: loops that a lighter load makes unstable have shorter ones."""

TALL = 6.0
"""Least swing, over the standard deviation of the input that the design allows for noise."""


@dataclass(slots=True)
class Ringing:
    """State of the detector.

    Attributes:
        extreme: Largest or smallest input of the present swing.
        rises: Whether the present swing is upwards.
        age: Samples since the last turn.
        swings: Tall and quick swings in a row.
    """

    extreme: float = 0.0
    rises: bool = True
    age: int = 0
    swings: int = 0


def is_ringing(state: Ringing, load_input: float, push: float, noise_max: float) -> bool:
    """Return whether the input has just completed the last of too many swings.

    Args:
        state: Overwritten.
        load_input: u[k-1] as applied.
        push: What the last change of the reference asked of the input.
        noise_max: Largest standard deviation of the input that noise may cause; 0 for no limit.
    """
    state.age += 1
    tall = TALL * noise_max
    if abs(push) > tall:
        state.swings = -1
    turned = state.extreme - load_input if state.rises else load_input - state.extreme
    if turned <= 0.0:
        state.extreme = load_input
        return False
    if not 0.0 < tall < turned:
        return False
    state.swings = state.swings + 1 if state.age <= QUICK else min(state.swings + 1, 1)
    state.rises = not state.rises
    state.extreme, state.age = load_input, 0
    return state.swings >= SWINGS
