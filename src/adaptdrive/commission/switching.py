"""The test of an experiment: V_c switches between two levels."""

from __future__ import annotations

import math

from adaptdrive.commission.bounds import Bounds
from adaptdrive.commission.course import ExperimentCourse, Outcome, Steps
from adaptdrive.util.errors import CommissionError

_BAND = 0.5
"""Distance beyond rest and movement that the test allows, as a share of the movement."""

_DRIFTING_BAND = 2.5
"""The same below the current of a battery, which falls while it is charged."""

_DRIFTING_LEAST = 3.0
"""Its bound whatever the noise: a mean below it ends the test."""

_CLOCKS = (5.0, 15.0)
"""Clocks of the slow and of the fast sequence in the time to rest."""

_LONG = 2.0
"""Length of the last two levels in times to rest."""

_LOWERED = 0.7
"""Ratio of the upper level to the one before that would have led to the edge."""

_REPEATS = 2
_ACCURACY = 0.005
"""Relative standard deviation of the gain that the length of the test aims at."""

_TAPS = (5, 3)
_LENGTH = 2 ** _TAPS[0] - 1


class Switching:
    """V_c between rest and a level, in pseudo-random sequences."""

    def __init__(self, course: ExperimentCourse, outcome: Outcome, bounds: Bounds) -> None:
        """Take what the climb has found.

        Args:
            course: The experiment.
            outcome: The two levels.
            bounds: The credible loads.
        """
        self._course = course
        self._outcome = outcome
        self._bounds = bounds
        self._high_V = outcome.high_V

    def run(self) -> Steps[None]:
        """Switch between the two levels; the output stays within its band."""
        course, settling_s = self._course, self._outcome.settling_s
        slow_s, fast_s = (settling_s / clocks for clocks in _CLOCKS)
        sequence = [(level, clock_s) for clock_s in (slow_s, fast_s) for level in _sequence()]
        duration_s = _LENGTH * (slow_s + fast_s)
        repeats = max(_REPEATS, math.ceil(self._sufficient_s() / duration_s))
        course.expect(repeats * duration_s + 2.0 * _LONG * settling_s)
        for _ in range(repeats):
            for level, clock_s in sequence:
                yield from self._hold(clock_s, level=level)
        for level in (True, False):
            yield from self._hold(_LONG * settling_s, level=level)

    def _hold(self, duration_s: float, *, level: bool) -> Steps[None]:
        """Hold a level of the test, the upper or the lower one, for a time."""
        course, low_V = self._course, self._outcome.low_V
        course.voltage_V = self._high_V if level else low_V
        until_s = course.time_s + duration_s
        while course.time_s < until_s:
            yield True
            if not course.look_is_due():
                continue
            self._look_at_band()
            if course.target.onset is None and self._bounds.heads_for_edge():
                self._back_off()

    def _back_off(self) -> None:
        """Take V_c back until the next level, which is lower from now on."""
        course, target, low_V = self._course, self._course.target, self._outcome.low_V
        if course.voltage_V != low_V:
            step = target.to_input(course.voltage_V) - target.to_input(low_V)
            self._high_V = target.raised_V(low_V, _LOWERED * step)
            course.voltage_V = low_V

    def _look_at_band(self) -> None:
        course, target, rest = self._course, self._course.target, self._outcome.rest
        noise = course.margin(0.0)
        fall = _BAND * target.move + noise
        if target.onset is not None:
            fall = min(_DRIFTING_BAND * target.move + noise, _DRIFTING_LEAST * target.move)
        low = rest - fall
        high = rest + (1.0 + _BAND) * target.move + noise
        output = course.recent(course.smooth_s)
        if not low <= output <= high:
            raise CommissionError(
                f"{target.name} = {output:.4g} {target.unit} left the band "
                f"{low:.4g}…{high:.4g} {target.unit} of the test: the load has changed"
            )

    def _sufficient_s(self) -> float:
        """Return the time in which the noise lets the gain be known to `_ACCURACY`."""
        course, outcome = self._course, self._outcome
        passed_s = course.time_s - outcome.began_s
        count = course.record.count(outcome.began_s, course.time_s)
        deviation = outcome.noise / (0.5 * _ACCURACY * course.target.move)
        return 2.0 * deviation * deviation * passed_s / max(1, count)


def _sequence() -> list[bool]:
    """Return a maximum-length sequence of 31 levels (x⁵ + x³ + 1)."""
    register, levels = [True] * _TAPS[0], []
    for _ in range(_LENGTH):
        levels.append(register[-1])
        register = [register[_TAPS[0] - 1] ^ register[_TAPS[1] - 1], *register[:-1]]
    return levels
