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
from enum import IntEnum

from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.thresholds import EARLIEST, FEWEST, MEMORY, WINDOW

# The watch over the adaptive controller: when to return to the fixed one, and for how long.

CLOSER = 0.9
"""Ratio of a distance to the one before that shows a way: a lag of nine times `saturated_s` goes a
tenth of it in that time."""

GROWTH = 1.0 / CLOSER
"""Ratio of a growing peak to the one before: noise changes equal peaks by less than a tenth."""

SWINGS = FEWEST
"""Growing peaks in a row: two and a half oscillations, which a step response does not make."""

TIME_CONSTANTS = EARLIEST
"""Closed-loop time constants with a large error: four equal poles have let a step decay to 1 %."""


class Fallback(IntEnum):
    """Reason for a fallback to the fixed controller."""

    NONE = 0
    SATURATED = 1
    ERROR = 2
    OSCILLATING = 3
    BLIND = 4


class LoopMonitor:
    """Watch over the adaptive controller, and over the answer of the load to either one.

    Attributes:
        fallback: Reason to be under the fixed controller, 0 for none.
        slow: Output of a load with the nominal gain and the longest lag within bounds.
    """

    def __init__(self, limits: SupervisionLimits, output: float) -> None:
        """Begin without a cause.

        Args:
            limits: Limits and bounds.
            output: Where the nominal load rests at the present input.
        """
        self._limits = limits
        self.fallback: int = Fallback.NONE
        self.slow = output
        self._fast = output  # the same with the shortest lag
        self._calm_periods = 0
        self._asked = False
        self._stuck_periods = 0  # at a limit, away from rest and without coming closer
        self._stuck_distance = 0.0
        self._limit_periods = 0  # with the input at a limit; output and lags when that began:
        self._limit_output = self._limit_fast = self._limit_slow = 0.0
        self._moved = 0.0
        self._error_periods = 0
        self._last_error = self._peak = self._last_peak = 0.0
        self._swings = 0

    def check(
        self,
        *,
        error: float,
        strayed: float,
        rest_distance: float,
        pole: float,
        held_share: float,
        saturated: bool,
        asked: bool,
    ) -> None:
        """Check one slow period, and keep a reason to return to the fixed controller.

        Args:
            error: r - y.
            strayed: Response that was asked for, minus y: a slow pole alone is no error.
            rest_distance: How far y is from where a model rests at this input.
            pole: Closed-loop pole in force.
            held_share: Share of the period without fresh measurements.
            saturated: Whether the last input was at a limit or could not be followed.
            asked: Whether adaptive is asked for.
        """
        self._watch_saturation(rest_distance, saturated)
        small = saturated or abs(strayed) <= self._limits.error_limit
        self._error_periods = 0 if small else self._error_periods + 1
        self._watch_swings(error)
        self._latch(self._reason(pole, held_share), asked)

    def _reason(self, pole: float, held_share: float) -> int:
        limits = self._limits
        if held_share > 1.0 - held_share:  # more is guessed than measured
            return Fallback.BLIND
        if 0 < limits.saturated_periods < self._stuck_periods:
            return Fallback.SATURATED
        if limits.error_limit > 0.0 and self._error_periods * (1.0 - pole) > TIME_CONSTANTS:
            return Fallback.ERROR
        return Fallback.OSCILLATING if self._swings >= SWINGS else Fallback.NONE

    def _latch(self, reason: int, asked: bool) -> None:
        """Keep a reason, while adaptive is asked for, until its cause is gone.

        Asking for adaptive anew arms the watch again.
        """
        calm = reason == Fallback.NONE and self._stuck_periods == 0 and self._error_periods == 0
        self._calm_periods = self._calm_periods + 1 if calm else 0
        if asked and not self._asked:
            self.fallback = Fallback.NONE
            self._error_periods = self._swings = 0
        elif asked and self.fallback == Fallback.NONE:
            self.fallback = reason
        elif self.fallback != Fallback.OSCILLATING and self._calm_periods >= WINDOW:
            self.fallback = Fallback.NONE
        self._asked = asked

    def check_response(
        self, expected: float, lag_periods: float, output: float, saturated: bool
    ) -> bool:
        """Follow the input with both lags; return whether the load must have moved and has not.

        Args:
            expected: Where the nominal load rests at the input of the elapsed period.
            lag_periods: Sum of its time constants, in slow periods.
            output: y.
            saturated: Whether that input was at a limit or could not be followed.
        """
        limits = self._limits
        self._fast += _share(limits.ratio_min * lag_periods) * (expected - self._fast)
        self.slow += _share(limits.ratio_max * lag_periods) * (expected - self.slow)
        if not saturated:
            self._limit_periods = 0
            return False
        if self._limit_periods == 0:
            self._limit_output, self._moved = output, 0.0
            self._limit_fast, self._limit_slow = self._fast, self.slow
        self._limit_periods += 1
        self._moved = max(self._moved, abs(output - self._limit_output))
        return self._is_unresponsive()

    def _is_unresponsive(self) -> bool:
        limits = self._limits
        long = 0 < limits.response_periods < self._limit_periods
        if not long or self._moved >= limits.response_distance:
            return False
        fast, slow = abs(self._fast - self._limit_fast), abs(self.slow - self._limit_slow)
        return limits.ratio_min * min(fast, slow) > limits.response_distance

    def _watch_saturation(self, rest_distance: float, saturated: bool) -> None:
        """Count the periods at a limit in which the output neither rests nor comes closer to it."""
        if not saturated or rest_distance <= self._limits.response_distance:
            self._stuck_periods = 0
            return
        if self._stuck_periods == 0 or rest_distance < CLOSER * self._stuck_distance:
            self._stuck_periods = 0
            self._stuck_distance = rest_distance
        self._stuck_periods += 1

    def _watch_swings(self, error: float) -> None:
        if error * self._last_error < 0.0:
            grows = self._peak > GROWTH * self._last_peak and self._peak >= self._limits.swing_min
            self._swings = self._swings + 1 if grows else 0
            self._last_peak, self._peak = self._peak, 0.0
        self._peak = max(self._peak, abs(error))
        self._last_error = error


def _share(lag_periods: float) -> float:
    """Share of its way that a first-order lag goes in one slow period."""
    return 1.0 - math.exp(-1.0 / lag_periods) if lag_periods > 0.0 else 1.0


# The watch over the fixed controller: a limit cycle ends in the safe state.

TRAVERSES = MEMORY
"""Ways of the input from one limit to the other that are a limit cycle: all that an estimate and
the mean errors remember is the cycle then."""

LONGEST_WAY = MEMORY
"""Slow periods after which a way belongs to no cycle: the one before is forgotten by then."""

AT_LIMIT = 1.0 - CLOSER
"""Distance from a limit, as a share of the range of the input, that counts as at the limit."""

FAR_BETTER = 3.0
"""Ratio of rms prediction errors, model over estimate, that contradicts model and bounds."""


class CycleMonitor:
    """Watch over the fixed controller for a limit cycle.

    Attributes:
        traverses: Ways from limit to limit in a row.
    """

    def __init__(self, reference_step: float) -> None:
        """Begin without a way.

        Args:
            reference_step: Smallest change of the set-point that begins the count anew; infinite
                for no watch.
        """
        self._reference_step = reference_step
        self.traverses = 0
        self._side = 0  # limit at which the input was last: -1, 1, or 0 for none yet
        self._way_periods = 0  # slow periods since then
        self._reference = 0.0

    def check(self, position: float, reference: float, better: float, fixed: bool) -> bool:
        """Check one slow period; return whether the loop is in a limit cycle.

        Args:
            position: Input in force, 0 at its lowest and 1 at its highest.
            reference: r.
            better: Rms prediction error of the model, its mean left out, over that of the estimate.
            fixed: Whether the fixed controller is in force.
        """
        if math.isinf(self._reference_step):
            return False
        if not fixed or abs(reference - self._reference) > self._reference_step:
            self._side = self.traverses = 0
            self._reference = reference
        self._way_periods += 1
        side = 1 if position >= 1.0 - AT_LIMIT else -1 if position <= AT_LIMIT else 0
        if side != 0:
            self._arrive(side)
        return fixed and self.traverses >= TRAVERSES and better > FAR_BETTER

    def _arrive(self, side: int) -> None:
        """Count a way that has ended at a limit."""
        if self._way_periods > LONGEST_WAY:
            self.traverses = 0
        elif side == -self._side:
            self.traverses += 1
        self._side, self._way_periods = side, 0
