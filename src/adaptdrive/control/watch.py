"""The watch over the adaptive controller: when to return to the fixed one, and stay there.

Estimates can be sound and the loop still be in trouble. The watch looks at what happens: an input
that stays at its limit, an error that stays large although the input is free, errors that swing
with growing peaks, measurements that fail. Any of them returns to the fixed controller. The return
is latched: only the operator, by asking for adaptive again, arms it anew.

The response monitor asks whether the load answers at all: an input held at its limit must move the
output. If it does not, the sensor or the drive is broken, and no controller can help.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from adaptdrive.control.settings import Jacket

GROWTH = 1.1
SWINGS = 6
TIME_CONSTANTS = 5.0
HELD_SHARE = 0.5


class Fallback(IntEnum):
    """Why the fixed controller was taken back."""

    NONE = 0
    SATURATED = 1
    ERROR = 2
    OSCILLATING = 3
    BLIND = 4


@dataclass(slots=True)
class WatchState:
    """What the watch remembers.

    Attributes:
        fallback: Latched reason, 0 for none.
        asked: Whether adaptive was asked for in the last period.
        saturated_periods: Periods in a row with the input at a limit.
        saturated_output: Output when that began.
        moved: Largest distance of the output from it since.
        error_periods: Periods in a row with a large error and a free input.
        last_error: Error of the last period.
        peak: Largest error since it last changed its sign.
        last_peak: The peak before.
        swings: Growing peaks in a row.
    """

    fallback: int = Fallback.NONE
    asked: bool = False
    saturated_periods: int = 0
    saturated_output: float = 0.0
    moved: float = 0.0
    error_periods: int = 0
    last_error: float = 0.0
    peak: float = 0.0
    last_peak: float = 0.0
    swings: int = 0


def watch_loop(
    state: WatchState,
    jacket: Jacket,
    error: float,
    output: float,
    pole: float,
    held_share: float,
    saturated: bool,
) -> int:
    """Look at one slow period.

    Args:
        state: Overwritten.
        jacket: Limits.
        error: r - y.
        output: y.
        pole: Closed-loop pole in force.
        held_share: Share of the period without fresh measurements.
        saturated: Whether the last input was at a limit or could not be followed.

    Returns:
        The reason to return to the fixed controller, 0 for none.
    """
    _watch_saturation(state, output, saturated)
    _watch_error(state, jacket, error, saturated)
    _watch_swings(state, jacket, error)
    if held_share > HELD_SHARE:
        return Fallback.BLIND
    if 0 < jacket.saturated_periods < state.saturated_periods:
        return Fallback.SATURATED
    if jacket.error_limit > 0.0 and state.error_periods * (1.0 - pole) > TIME_CONSTANTS:
        return Fallback.ERROR
    if state.swings >= SWINGS:
        return Fallback.OSCILLATING
    return Fallback.NONE


def latch_fallback(state: WatchState, reason: int, asked: bool) -> None:
    """Latch a reason while adaptive is asked for; asking for it anew arms the watch again."""
    if asked and not state.asked:
        state.fallback = Fallback.NONE
        state.error_periods = state.swings = 0
    elif asked and state.fallback == Fallback.NONE:
        state.fallback = reason
    state.asked = asked


def is_unresponsive(state: WatchState, jacket: Jacket) -> bool:
    """True when the input has been at its limit for long and the output has not moved."""
    long = 0 < jacket.response_periods < state.saturated_periods
    return long and state.moved < jacket.response_distance


def _watch_saturation(state: WatchState, output: float, saturated: bool) -> None:
    if not saturated:
        state.saturated_periods = 0
        return
    if state.saturated_periods == 0:
        state.saturated_output = output
        state.moved = 0.0
    state.saturated_periods += 1
    state.moved = max(state.moved, abs(output - state.saturated_output))


def _watch_error(state: WatchState, jacket: Jacket, error: float, saturated: bool) -> None:
    if saturated or abs(error) <= jacket.error_limit:
        state.error_periods = 0
    else:
        state.error_periods += 1


def _watch_swings(state: WatchState, jacket: Jacket, error: float) -> None:
    if error * state.last_error < 0.0:
        small = state.peak < jacket.swing_min
        grows = state.peak > GROWTH * state.last_peak
        state.swings = state.swings + 1 if grows and not small else 0
        state.last_peak, state.peak = state.peak, 0.0
    state.peak = max(state.peak, abs(error))
    state.last_error = error
