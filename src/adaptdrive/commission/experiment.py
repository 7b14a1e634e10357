"""The experiment on an unknown load: from samples to the next V_c, without a model.

1. At the lowest V_c the load comes to rest. A battery is raised until a current flows.
2. V_c rises by a small step, which is doubled each time the load has come to rest, until the output
   has moved by a visible share of the movement asked for. V_c goes back where a load that the
   samples leave credible would lead the output to the edge of the band.
3. A pseudo-random binary sequence switches V_c between rest and the step at which no credible load
   moves the output further than was asked for. Its clock follows from the time that the load took.

A load without overshoot stays within that movement. Time is that of the samples.
"""

from __future__ import annotations

from adaptdrive.commission.climb import Climb, Summit
from adaptdrive.commission.course import ExperimentCourse, Outcome, Phase, Steps
from adaptdrive.commission.rest import Rest, find_onset, until_rest
from adaptdrive.commission.switching import Switching
from adaptdrive.commission.target import Target

_LEAST_LEVEL = 0.5
"""Least step of the test, over the one that would move the output by the movement asked for."""


class LoadExperiment:
    """An experiment that is fed with samples and returns V_c.

    Attributes:
        outcome: The result, None before the end of the climb.
        course: Its samples, limits and phase, and the V_c that is asked for.
    """

    def __init__(self, target: Target) -> None:
        self.outcome: Outcome | None = None
        self.course = ExperimentCourse(target)
        self._steps = self._run()

    def take(self, time_s: float, boost_voltage_V: float, output: float) -> float:
        """Take a sample and return V_c.

        Args:
            time_s: Its time.
            boost_voltage_V: Boost voltage.
            output: Output.

        Raises:
            CommissionError: The experiment cannot continue; V_c must go to the safe state.
        """
        self.course.append(time_s, boost_voltage_V, output)
        if not self.done and next(self._steps, None) is None:
            self.course.phase = Phase.DONE
        return self.course.voltage_V

    @property
    def done(self) -> bool:
        """True when the test is complete."""
        return self.course.phase is Phase.DONE

    def _run(self) -> Steps[None]:
        """Run all phases, one step for each sample."""
        course = self.course
        base_V, rest = course.target.low_V, Rest()
        if course.target.onset is not None:
            course.phase = Phase.ONSET
            base_V = yield from find_onset(course)
        yield from until_rest(course, rest)
        began_s, climb = course.time_s, Climb(course, base_V, rest)
        summit = yield from climb.run()
        self.outcome = _judge(course, base_V, summit, began_s, climb.bounds.gain)
        course.phase = Phase.TEST
        yield from Switching(course, self.outcome, climb.bounds).run()


def _judge(
    course: ExperimentCourse, base_V: float, summit: Summit, began_s: float, largest_gain: float
) -> Outcome:
    """Choose the level at which no credible load moves the output further than was asked for."""
    target, moved = course.target, summit.moved
    gain = moved / (target.to_input(summit.voltage_V) - target.to_input(base_V))
    if target.onset is None:
        gain = min(max(gain, largest_gain), gain / _LEAST_LEVEL)
    high_V = target.raised_V(base_V, target.move / gain)
    course.look_at_terminals(high_V, summit.rest + target.move)
    noise = course.record.noise(began_s, course.time_s)
    return Outcome(base_V, high_V, summit.rest, moved, gain, summit.settling_s, noise, began_s)
