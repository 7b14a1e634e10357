"""Monitors of both controllers: when to return to the fixed one, and when to stop.

Estimates can be sound and the loop still be in trouble. The watch checks the closed loop: an input
that stays at its limit while the output neither rests where a model puts it nor comes closer, an
output that stays far from the response that was asked for although the input is free, errors that
swing with growing peaks, measurements that fail. Any of them returns to the fixed controller, until
nothing of the kind has been seen for `WINDOW` slow periods. A loop that swings by its own gains
would do so again: that return is latched, and only the operator, by asking for adaptive again,
ends it.

The response monitor trips where a load must have moved and has not: the sensor or the drive is
broken then, and no controller can help. Two first-order lags follow the input, one as fast and one
as slow as the quickest and the slowest load within the supervisor's bounds. While the input is at
its limit, a load of the smallest gain within the bounds moves at least `ratio_min` times the
smaller of their movements.

A fixed controller on a load far from its model can drive the input from one limit to the other for
ever. Noise does that too, and so do set-points that change; a limit cycle differs from them by a
set-point that rests, and by an estimate that predicts the movements of the load far better than the
model. A constant error of the model does not count: the integrator removes it, and noise that moves
the input from limit to limit would otherwise trip a healthy drive whose model is a little wrong.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.thresholds import MEMORY, WINDOW

# The watch over the adaptive controller: when to return to the fixed one, and for how long.

CLOSER = 0.9
"""Ratio of a distance to the one before that shows a way: a lag of nine times `saturated_s` goes a
tenth of it in that time."""

GROWTH = 1.0 / CLOSER
"""Ratio of a growing peak to the one before: noise changes equal peaks by less than a tenth."""

SWINGS = 6
"""Growing peaks in a row: three full oscillations, which a step response does not make."""

TIME_CONSTANTS = 10.0
"""Closed-loop time constants with a large error: four equal poles have let a step decay to 1 %."""


class Fallback(IntEnum):
    """Reason for a fallback to the fixed controller."""

    NONE = 0
    SATURATED = 1
    ERROR = 2
    OSCILLATING = 3
    BLIND = 4


@dataclass(slots=True)
class MonitorState:
    """State of the watch.

    Attributes:
        fallback: Reason, 0 for none.
        calm_periods: Periods in a row in which the watch has seen nothing.
        asked: Whether adaptive was asked for in the last period.
        stuck_periods: Periods in a row at a limit, away from rest and without coming closer.
        stuck_distance: Distance from rest when the count began.
        fast: Output of a load with the nominal gain and the shortest lag within bounds.
        slow: Output of a load with the nominal gain and the longest lag within bounds.
        limit_periods: Periods in a row with the input at a limit.
        limit_output: Output when that began.
        limit_fast: `fast` when that began.
        limit_slow: `slow` when that began.
        moved: Largest distance of the output from `limit_output` since.
        error_periods: Periods in a row with a large error and a free input.
        last_error: Error of the last period.
        peak: Largest error since it last changed its sign.
        last_peak: The peak before.
        swings: Growing peaks in a row.
    """

    fallback: int = Fallback.NONE
    calm_periods: int = 0
    asked: bool = False
    stuck_periods: int = 0
    stuck_distance: float = 0.0
    fast: float = 0.0
    slow: float = 0.0
    limit_periods: int = 0
    limit_output: float = 0.0
    limit_fast: float = 0.0
    limit_slow: float = 0.0
    moved: float = 0.0
    error_periods: int = 0
    last_error: float = 0.0
    peak: float = 0.0
    last_peak: float = 0.0
    swings: int = 0


def monitor_loop(
    state: MonitorState,
    supervision: SupervisionLimits,
    error: float,
    strayed: float,
    rest_distance: float,
    pole: float,
    held_share: float,
    saturated: bool,
) -> int:
    """Check one slow period.

    Args:
        state: Overwritten.
        supervision: Limits.
        error: r - y.
        strayed: Response that was asked for, minus y: a slow pole alone is no error.
        rest_distance: How far y is from where a model rests at this input.
        pole: Closed-loop pole in force.
        held_share: Share of the period without fresh measurements.
        saturated: Whether the last input was at a limit or could not be followed.

    Returns:
        The reason to return to the fixed controller, 0 for none.
    """
    _watch_saturation(state, supervision, rest_distance, saturated)
    _watch_error(state, supervision, strayed, saturated)
    _watch_swings(state, supervision, error)
    if held_share > 1.0 - held_share:  # more is guessed than measured
        return Fallback.BLIND
    if 0 < supervision.saturated_periods < state.stuck_periods:
        return Fallback.SATURATED
    if supervision.error_limit > 0.0 and state.error_periods * (1.0 - pole) > TIME_CONSTANTS:
        return Fallback.ERROR
    if state.swings >= SWINGS:
        return Fallback.OSCILLATING
    return Fallback.NONE


def latch_fallback(state: MonitorState, reason: int, asked: bool) -> None:
    """Keep a reason, while adaptive is asked for, until its cause is gone or the operator ends it.

    Asking for adaptive anew arms the watch again.
    """
    calm = reason == Fallback.NONE and state.stuck_periods == 0 and state.error_periods == 0
    state.calm_periods = state.calm_periods + 1 if calm else 0
    if asked and not state.asked:
        state.fallback = Fallback.NONE
        state.error_periods = state.swings = 0
    elif asked and state.fallback == Fallback.NONE:
        state.fallback = reason
    elif state.fallback != Fallback.OSCILLATING and state.calm_periods >= WINDOW:
        state.fallback = Fallback.NONE
    state.asked = asked


def monitor_response(
    state: MonitorState,
    supervision: SupervisionLimits,
    expected: float,
    lag_periods: float,
    output: float,
    saturated: bool,
) -> bool:
    """Follow the input with both lags; True when the load must have moved and has not.

    Args:
        state: Overwritten.
        supervision: Limits and bounds.
        expected: Where the nominal load rests at the input of the elapsed period.
        lag_periods: Sum of its time constants, in slow periods.
        output: y.
        saturated: Whether that input was at a limit or could not be followed.
    """
    state.fast += _share(supervision.ratio_min * lag_periods) * (expected - state.fast)
    state.slow += _share(supervision.ratio_max * lag_periods) * (expected - state.slow)
    if not saturated:
        state.limit_periods = 0
        return False
    if state.limit_periods == 0:
        state.limit_output, state.moved = output, 0.0
        state.limit_fast, state.limit_slow = state.fast, state.slow
    state.limit_periods += 1
    state.moved = max(state.moved, abs(output - state.limit_output))
    return _is_unresponsive(state, supervision)


def _is_unresponsive(state: MonitorState, supervision: SupervisionLimits) -> bool:
    long = 0 < supervision.response_periods < state.limit_periods
    if not long or state.moved >= supervision.response_distance:
        return False
    fast, slow = abs(state.fast - state.limit_fast), abs(state.slow - state.limit_slow)
    return supervision.ratio_min * min(fast, slow) > supervision.response_distance


def _share(lag_periods: float) -> float:
    """Share of its way that a first-order lag goes in one slow period."""
    return 1.0 - math.exp(-1.0 / lag_periods) if lag_periods > 0.0 else 1.0


def _watch_saturation(
    state: MonitorState, supervision: SupervisionLimits, rest_distance: float, saturated: bool
) -> None:
    """Count the periods at a limit in which the output neither rests nor comes closer to it."""
    if not saturated or rest_distance <= supervision.response_distance:
        state.stuck_periods = 0
        return
    if state.stuck_periods == 0 or rest_distance < CLOSER * state.stuck_distance:
        state.stuck_periods = 0
        state.stuck_distance = rest_distance
    state.stuck_periods += 1


def _watch_error(
    state: MonitorState, supervision: SupervisionLimits, strayed: float, saturated: bool
) -> None:
    small = saturated or abs(strayed) <= supervision.error_limit
    state.error_periods = 0 if small else state.error_periods + 1


def _watch_swings(state: MonitorState, supervision: SupervisionLimits, error: float) -> None:
    if error * state.last_error < 0.0:
        small = state.peak < supervision.swing_min
        grows = state.peak > GROWTH * state.last_peak
        state.swings = state.swings + 1 if grows and not small else 0
        state.last_peak, state.peak = state.peak, 0.0
    state.peak = max(state.peak, abs(error))
    state.last_error = error


# The watch over the fixed controller: a limit cycle ends in the safe state.

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
class LimitCycleState:
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


def monitor_limit_cycle(
    state: LimitCycleState,
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


def _arrive(state: LimitCycleState, side: int) -> None:
    """Count a way that has ended at a limit."""
    if state.way_periods > LONGEST_WAY:
        state.traverses = 0
    elif side == -state.side:
        state.traverses += 1
    state.side, state.way_periods = side, 0
