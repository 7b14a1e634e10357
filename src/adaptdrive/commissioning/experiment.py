"""The experiment on an unknown load: from samples to the next V_c, without a model.

1. At the lowest V_c the load comes to rest. A battery is raised until a current flows.
2. V_c rises by a small step, which is doubled each time the load has come to rest, until the output
   has moved by a visible share of the movement asked for. V_c goes back where a load that the
   samples leave credible would lead the output to the edge of the band.
3. A pseudo-random binary sequence switches V_c between rest and the step at which no credible load
   moves the output further than was asked for. Its clock follows from the time that the load took.

A load without overshoot stays within that movement. Time is that of the samples.
"""

import math

from adaptdrive.commissioning import bounds
from adaptdrive.commissioning.course import ExperimentCourse, Outcome, Phase, Steps, Target
from adaptdrive.util.errors import CommissionError

# The test of an experiment: V_c switches between two levels.

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


def switch(course: ExperimentCourse, outcome: Outcome, loads: bounds.CredibleLoads) -> Steps[None]:
    """Switch V_c between rest and a level, in pseudo-random sequences.

    Args:
        course: The experiment, whose output stays within its band.
        outcome: The two levels; the upper one is lowered where it leads to the edge of the band.
        loads: What the samples leave credible.

    Raises:
        CommissionError: The output leaves its band.
    """
    target, settling_s, high_V = course.target, outcome.settling_s, outcome.high_V
    clocks_s = [settling_s / clocks for clocks in _CLOCKS]
    sequence = [(level, clock_s) for clock_s in clocks_s for level in _sequence()]
    duration_s = _LENGTH * sum(clocks_s)
    repeats = max(_REPEATS, math.ceil(_sufficient_s(course, outcome) / duration_s))
    course.expect(repeats * duration_s + 2.0 * _LONG * settling_s)
    ends = [(level, _LONG * settling_s) for level in (True, False)]
    for level, length_s in (*(repeats * sequence), *ends):
        course.voltage_V = high_V if level else outcome.low_V
        until_s = course.time_s + length_s
        while course.time_s < until_s:
            yield True
            if not course.look_is_due():
                continue
            _look_at_band(course, outcome.rest)
            if loads.heads_for_edge() and course.voltage_V != outcome.low_V:
                step = target.to_input(high_V) - target.to_input(outcome.low_V)
                high_V = target.raised_V(outcome.low_V, _LOWERED * step)
                course.voltage_V = outcome.low_V


def _look_at_band(course: ExperimentCourse, rest: float) -> None:
    target, noise = course.target, course.margin(0.0)
    fall = _BAND * target.move + noise
    if target.battery is not None:
        fall = min(_DRIFTING_BAND * target.move + noise, _DRIFTING_LEAST * target.move)
    low, high = rest - fall, rest + (1.0 + _BAND) * target.move + noise
    output = course.recent(course.smooth_s)
    if not low <= output <= high:
        raise CommissionError(
            f"{target.name} = {output:.4g} {target.unit} left the band "
            f"{low:.4g}…{high:.4g} {target.unit} of the test: the load has changed"
        )


def _sufficient_s(course: ExperimentCourse, outcome: Outcome) -> float:
    """Return the time in which the noise lets the gain be known to `_ACCURACY`."""
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


# The search of an experiment for a step of V_c that moves the output visibly.

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

_LEAST_LEVEL = 0.5
"""Least step of the test, over the one that would move the output by the movement asked for."""

_LONGEST_CLIMB = 40


class Climb:
    """Steps of V_c from rest, each no larger than the credible loads allow."""

    def __init__(self, course: ExperimentCourse, base_V: float) -> None:
        """Begin where the load of the experiment has come to rest, at a V_c."""
        self.loads = bounds.CredibleLoads(course, base_V)
        self._course = course
        self._base_V = base_V
        self._before = course.rest
        self._began_s = self._raised_s = course.time_s
        self._retreats = False

    def run(self) -> Steps[Outcome]:
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
            if course.phase is Phase.BACK or moved > _TOO_FAR * target.move:
                step = yield from self._retreat(step)
                continue
            if moved >= _ENOUGH * target.move:
                return self._outcome(moved, raised_V)
            self._follow(moved)
            if raised_V >= target.high_V:
                raise self._no_response(moved, raised_V)
            growth = _SLOW_GROWTH if self._retreats else _GROWTH
            larger = growth * step  # as far as the credible loads allow; a battery's current jumps
            if target.battery is None:
                larger = self.loads.largest_step(larger)
            step = max(step, larger)
        raise CommissionError(
            f"{_LONGEST_CLIMB} steps of {target.given.symbol} did not show one that moves "
            f"{target.name} by {target.move:.3g} {target.unit}: ask for a longer wait with "
            "--patience"
        )

    def _outcome(self, moved: float, raised_V: float) -> Outcome:
        """Choose the level at which no credible load moves the output further than asked for."""
        course, target, base_V, rest = self._course, self._course.target, self._base_V, self._before
        gain = moved / (target.to_input(raised_V) - target.to_input(base_V))
        if target.battery is None:
            gain = min(max(gain, self.loads.gain), gain / _LEAST_LEVEL)
        high_V = target.raised_V(base_V, target.move / gain)
        course.look_at_terminals(high_V, rest + target.move)
        began_s, settling_s = self._began_s, self._time_to_rest()
        noise = course.record.noise(began_s, course.time_s)
        return Outcome(base_V, high_V, rest, moved, gain, settling_s, noise, began_s)

    def _follow(self, moved: float) -> None:
        """Wait for no longer than a response takes that was seen from its begin to its rest."""
        course = self._course
        if course.target.battery is None and moved > course.margin(_SEEN):
            wait_s = max(_RESPONSES * self._time_to_rest(), _LEAST_WAIT * course.target.patience_s)
            course.wait_s = min(course.wait_s, wait_s)

    def _respond(self, voltage_V: float) -> Steps[float]:
        """Raise V_c and wait for rest; the movement is returned, early where it is too large."""
        course, target, before_V = self._course, self._course.target, self._course.voltage_V
        course.look_at_terminals(voltage_V, self._before + target.move)
        began_s = course.time_s
        if voltage_V != before_V:
            course.voltage_V, self._raised_s = voltage_V, began_s
        for _ in bounds.until_rest(course):
            moved = course.recent(course.smooth_s) - self._before
            # too far, or would be although V_c went back now
            if self.loads.heads_for_edge() or moved > _TOO_FAR * target.move:
                course.phase = Phase.BACK
                return moved
            if moved < -course.margin(_FALL):
                raise CommissionError(
                    f"{target.name} fell by {-moved:.3g} {target.unit} when {target.given.symbol} "
                    f"rose to {target.given.text(voltage_V)}: is its sensor reversed?"
                )
            yield True
        moved = self._course.rest - self._before
        if target.battery is None:
            return moved
        slewed_s = began_s + abs(voltage_V - before_V) / bounds.SLOWEST_SLEW_V_PER_S
        nearly_V = before_V + _ARRIVED * (voltage_V - before_V)
        ready_s = max(slewed_s, course.record.reached_s(nearly_V, began_s))
        jump = course.record.mean(ready_s, ready_s + 5.0 * course.smooth_s)
        return max(moved, jump - self._before)

    def _retreat(self, step: float) -> Steps[float]:
        """Take V_c back, wait for rest, and return the next step."""
        course, target = self._course, self._course.target
        course.phase, self._retreats = Phase.BACK, True
        course.voltage_V, self._raised_s = self._base_V, course.time_s
        peak = course.recent(course.smooth_s) - self._before
        for _ in range(_LONGEST_RETURN):
            for _ in bounds.until_rest(course):
                peak = max(peak, course.recent(course.smooth_s) - self._before)
                self.loads.heads_for_edge()
                yield True
            if abs(self._course.rest - self._before) <= course.margin(_BACK):
                break
        self._before = self._course.rest
        least, largest = _AFTER_RETREAT
        share = largest * target.move / max(peak, 1e-9 * target.move)
        if target.battery is None:
            share = largest * target.move / (self.loads.gain * step)
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
        if course.target.battery is not None:
            return elapsed_s
        rest = course.rest
        start = record.mean(began_s - course.smooth_s, began_s)
        allowed = 0.1 * abs(rest - start)
        while elapsed_s > 0.02 * course.target.patience_s:
            half_s = 0.5 * elapsed_s
            mean = record.mean(began_s + 0.6 * half_s, began_s + half_s)
            if not abs(mean - rest) <= allowed + 2.0 * course.standard_error(0.4 * half_s):
                break
            elapsed_s = half_s
        return elapsed_s


# The experiment on an unknown load: from samples to the next V_c, without a model.


def load_experiment(target: Target) -> ExperimentCourse:
    """Return an experiment that has taken no sample yet."""
    return ExperimentCourse(target, _phases)


def _phases(course: ExperimentCourse) -> Steps[None]:
    """Run all phases, one step for each sample."""
    base_V = course.target.low_V
    if course.target.battery is not None:
        course.phase = Phase.ONSET
        base_V = yield from bounds.find_onset(course)
    yield from bounds.until_rest(course)
    climb = Climb(course, base_V)
    course.outcome = yield from climb.run()
    course.phase = Phase.TEST
    yield from switch(course, course.outcome, climb.loads)
