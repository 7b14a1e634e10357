"""The search of an experiment for a step of V_c that moves the output visibly."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.commission.bounds import Bounds
from adaptdrive.commission.course import ExperimentCourse, Phase, Steps
from adaptdrive.commission.rest import Rest, until_rest
from adaptdrive.util.errors import CommissionError

_FIRST_SHARE = 0.25
"""Share of the movement that the first step brings, if the guess of the gain is right."""

_ENOUGH = 0.4
"""Share of the movement that shows the gain."""

_TOO_FAR = 1.1
"""Share of the movement at which V_c is taken back."""

_FALL = 0.5
"""Fall of the output, as a share of the movement, that shows a reversed sensor."""

_GROWTH, _SLOW_GROWTH = 2.0, 1.3
"""Largest ratio of a step to the one before, and the same once the output has moved too far."""

_AFTER_RETREAT = (0.1, 0.6)
"""Least and largest ratio of a step to the one before that moved the output too far."""

_BACK = 0.1
"""Distance from the rest before, as a share of the movement, at which the output is back."""

_LONGEST_RETURN = 20
"""Rests after which another rest than before is believed; at its peak an output rests too."""

_ARRIVED = 0.9
"""Share of a step of V_c after which the current of a battery is looked at."""

_SEEN = 0.1
"""Share of the movement that shows how long a response takes."""

_RESPONSES = 3.0
"""Shortest wait for rest in times to rest of a response that was seen."""

_LEAST_WAIT = 0.05
"""The same in patiences."""

_LONGEST_CLIMB = 40
_SLOWEST_SLEW_V_PER_S = 50.0


@dataclass(frozen=True, slots=True)
class Summit:
    """The step that was found.

    Attributes:
        rest: Output before it.
        moved: Change of the output.
        voltage_V: V_c.
        settling_s: Time that the load took to come to rest.
    """

    rest: float
    moved: float
    voltage_V: float
    settling_s: float


class Climb:
    """Steps of V_c from rest, each no larger than the credible loads allow."""

    def __init__(self, course: ExperimentCourse, base_V: float, rest: Rest) -> None:
        """Begin at rest.

        Args:
            course: The experiment.
            base_V: V_c at rest.
            rest: The rest.
        """
        self.bounds = Bounds(course, base_V, rest)
        self._course = course
        self._base_V = base_V
        self._rest = rest
        self._before = rest.output
        self._raised_s = course.time_s
        self._retreats = False

    def run(self) -> Steps[Summit]:
        """Raise V_c until the output has moved visibly.

        Raises:
            CommissionError: There is no such step.
        """
        course, target = self._course, self._course.target
        step = _FIRST_SHARE * target.move / target.first_gain
        for _ in range(_LONGEST_CLIMB):
            course.phase = Phase.CLIMB
            raised_V = target.raised_V(self._base_V, step)
            moved = yield from self._respond(raised_V)
            if course.phase is Phase.RETREAT or moved > _TOO_FAR * target.move:
                step = yield from self._retreat(step)
                continue
            if moved >= _ENOUGH * target.move:
                return Summit(self._before, moved, raised_V, self._time_to_rest())
            self._follow(moved)
            if raised_V >= target.high_V:
                raise self._no_response(moved, raised_V)
            growth = _SLOW_GROWTH if self._retreats else _GROWTH
            step = max(step, self._allowed(growth * step))
        raise CommissionError(
            f"{_LONGEST_CLIMB} steps of {target.given.symbol} did not show one that moves "
            f"{target.name} by {target.move:.3g} {target.unit}: ask for a longer wait with "
            "--patience"
        )

    def _follow(self, moved: float) -> None:
        """Wait for no longer than a response takes that was seen from its begin to its rest."""
        course = self._course
        if course.target.onset is None and moved > course.margin(_SEEN):
            wait_s = max(_RESPONSES * self._time_to_rest(), _LEAST_WAIT * course.target.patience_s)
            course.wait_s = min(course.wait_s, wait_s)

    def _allowed(self, step: float) -> float:
        """Return the largest step that the credible loads allow; a battery's current jumps."""
        return step if self._course.target.onset is not None else self.bounds.largest_step(step)

    def _respond(self, voltage_V: float) -> Steps[float]:
        """Raise V_c and wait for rest; the movement is returned, early where it is too large."""
        course, target, before_V = self._course, self._course.target, self._course.voltage_V
        course.look_at_terminals(voltage_V, self._before + target.move)
        began_s = course.time_s
        if voltage_V != before_V:
            course.voltage_V, self._raised_s = voltage_V, began_s
        for _ in until_rest(course, self._rest):
            moved = course.recent(course.smooth_s) - self._before
            if self._is_too_far(moved):
                course.phase = Phase.RETREAT
                return moved
            if moved < -course.margin(_FALL):
                raise CommissionError(
                    f"{target.name} fell by {-moved:.3g} {target.unit} when {target.given.symbol} "
                    f"rose to {target.given.text(voltage_V)}: is its sensor reversed?"
                )
            yield True
        moved = self._rest.output - self._before
        if target.onset is None:
            return moved
        slewed_s = began_s + abs(voltage_V - before_V) / _SLOWEST_SLEW_V_PER_S
        nearly_V = before_V + _ARRIVED * (voltage_V - before_V)
        ready_s = max(slewed_s, course.record.reached_s(nearly_V, began_s))
        jump = course.record.mean(ready_s, ready_s + 5.0 * course.smooth_s)
        return max(moved, jump - self._before)

    def _is_too_far(self, moved: float) -> bool:
        """Return whether the output has moved too far, or would although V_c went back now."""
        course = self._course
        heading = course.target.onset is None and self.bounds.heads_for_edge()
        return heading or moved > _TOO_FAR * course.target.move

    def _retreat(self, step: float) -> Steps[float]:
        """Take V_c back, wait for rest, and return the next step."""
        course, target = self._course, self._course.target
        course.phase, self._retreats = Phase.RETREAT, True
        course.voltage_V, self._raised_s = self._base_V, course.time_s
        peak = course.recent(course.smooth_s) - self._before
        for _ in range(_LONGEST_RETURN):
            for _ in until_rest(course, self._rest):
                peak = max(peak, course.recent(course.smooth_s) - self._before)
                if target.onset is None:
                    self.bounds.heads_for_edge()
                yield True
            if abs(self._rest.output - self._before) <= course.margin(_BACK):
                break
        self._before = self._rest.output
        least, largest = _AFTER_RETREAT
        share = largest * target.move / max(peak, 1e-9 * target.move)
        if target.onset is None:
            share = largest * target.move / (self.bounds.gain * step)
        return step * min(max(least, share), largest)

    def _no_response(self, moved: float, raised_V: float) -> CommissionError:
        target, given = self._course.target, self._course.target.given
        return CommissionError(
            f"no response: {target.name} moved by {moved:.3g} {target.unit} when {given.symbol} "
            f"rose from {given.text(self._base_V)} to {given.text(raised_V)}; wanted "
            f"{target.move:.3g} {target.unit}: look at sensor and load, or ask for a smaller "
            "movement"
        )

    def _time_to_rest(self) -> float:
        """Return the time after which the output stayed near its rest.

        The current of a battery jumps, and relaxes by less than can be seen in one response.
        """
        course, record = self._course, self._course.record
        began_s = self._raised_s
        elapsed_s = course.time_s - began_s
        if course.target.onset is not None:
            return elapsed_s
        rest = self._rest.output
        start = record.mean(began_s - course.smooth_s, began_s)
        allowed = 0.1 * abs(rest - start)
        while elapsed_s > 0.02 * course.target.patience_s:
            half_s = 0.5 * elapsed_s
            mean = record.mean(began_s + 0.6 * half_s, began_s + half_s)
            if not abs(mean - rest) <= allowed + 2.0 * course.standard_error(0.4 * half_s):
                break
            elapsed_s = half_s
        return elapsed_s
