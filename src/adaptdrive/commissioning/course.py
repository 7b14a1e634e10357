"""The course of an experiment: samples, phases, waits, limits, and the voltage it asks for."""

import bisect
import itertools
import math
import statistics
from collections.abc import Generator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

from adaptdrive.commissioning.target import Target
from adaptdrive.util.errors import CommissionError

# Samples of an experiment, and means over parts of them.

_NORMAL = 1.4826
"""Standard deviation over median deviation of a normal distribution."""


@dataclass(slots=True)
class Samples:
    """Boost voltage and output at increasing times.

    Attributes:
        times_s: Times.
        voltages_V: Boost voltages.
        outputs: Outputs.
        sums: Sum of the outputs before each, and of all.
    """

    times_s: list[float] = field(default_factory=list)
    voltages_V: list[float] = field(default_factory=list)
    outputs: list[float] = field(default_factory=list)
    sums: list[float] = field(default_factory=lambda: [0.0])

    def append(self, time_s: float, voltage_V: float, output: float) -> None:
        """Add a sample."""
        self.times_s.append(time_s)
        self.voltages_V.append(voltage_V)
        self.outputs.append(output)
        self.sums.append(self.sums[-1] + output)

    def count(self, from_s: float, to_s: float) -> int:
        """Return the number of samples after one time and until another."""
        return bisect.bisect(self.times_s, to_s) - bisect.bisect(self.times_s, from_s)

    def mean(self, from_s: float, to_s: float) -> float:
        """Return the mean output between two times, NaN where there is no sample."""
        first, last = bisect.bisect(self.times_s, from_s), bisect.bisect(self.times_s, to_s)
        return (self.sums[last] - self.sums[first]) / (last - first) if last > first else math.nan

    def reached_s(self, voltage_V: float, from_s: float) -> float:
        """Return when the boost voltage first reached a value after a time; that time if never."""
        for number in range(bisect.bisect(self.times_s, from_s), len(self.times_s)):
            if self.voltages_V[number] >= voltage_V:
                return self.times_s[number]
        return from_s

    def noise(self, from_s: float, to_s: float) -> float:
        """Return the standard deviation of the noise of one sample, from the differences.

        A slow movement does not count, and neither do spikes in less than half of the samples.
        """
        first, last = bisect.bisect(self.times_s, from_s), bisect.bisect(self.times_s, to_s)
        outputs = self.outputs[max(first, last - 2000) : last]
        steps = [abs(b - a) for a, b in itertools.pairwise(outputs)]
        if not steps:
            return 0.0
        middle = statistics.median(steps)
        robust = _NORMAL * middle / math.sqrt(2.0)
        # a coarse sensor repeats its value in most samples: then the mean square counts
        return robust or math.sqrt(statistics.fmean(step * step for step in steps) / 2.0)

    def resolution(self) -> float:
        """Return the smallest difference of two outputs in a row, 0 where all are the same."""
        steps = (abs(b - a) for a, b in itertools.pairwise(self.outputs))
        return min((step for step in steps if step > 0.0), default=0.0)

    def coarseness(self) -> float:
        """Return the resolution where it is larger than the noise, else 0."""
        if not self.outputs:
            return 0.0
        resolution = self.resolution()
        return resolution if resolution > self.noise(-math.inf, self.times_s[-1]) else 0.0


# The course of an experiment: its phases and samples, its limits, and the voltage it asks for.

Result = TypeVar("Result")
Steps = Generator[bool, None, Result]
"""A phase: it advances with each sample, and ends with a result."""


class Phase(StrEnum):
    """Part of an experiment."""

    REST = "waiting for rest at the lowest voltage"
    ONSET = "raising the voltage until a current flows"
    CLIMB = "looking for the step that moves the output visibly"
    RETREAT = "taking the voltage back: the output would move too far"
    TEST = "switching the voltage"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of an experiment.

    Attributes:
        low_V: V_c at rest.
        high_V: V_c of the sequence's other level.
        rest: Output at rest.
        moved: Change of the output by the last step of the climb.
        gain: That change over the change of the load's input.
        settling_s: Time that the load took to come to rest.
        noise: Standard deviation of the noise of one sample.
        began_s: Time from which the samples count.
    """

    low_V: float
    high_V: float
    rest: float
    moved: float
    gain: float
    settling_s: float
    noise: float
    began_s: float


_NOISE_DEVIATIONS = 6.0
"""Standard deviations of a mean that noise may add to a limit: it is looked at 10,000 times."""

_SMOOTH_SHARE = 0.02
"""Length of the means that are compared with limits, as a share of the shortest wait."""

_NOISE_SHARE = 0.05
"""Time between two looks at the noise, as a share of the shortest wait."""

_LOOK_SHARE = 0.005
"""Time between two looks at the band, as a share of the shortest wait: a quarter of a mean."""


class ExperimentCourse:
    """State that the phases of an experiment share.

    Attributes:
        target: Limits, and the movement that was asked for.
        record: All samples.
        phase: Where the experiment is.
        found: Share of the range in which the onset of a current is looked for, 0 to 1.
        voltage_V: V_c that is asked for.
        time_s: Time of the last sample.
        wait_s: Shortest wait for rest: the patience, less once the load has been seen to respond.
    """

    def __init__(self, target: Target) -> None:
        self.target = target
        self.record = Samples()
        self.phase = Phase.REST
        self.found = 0.0
        self.voltage_V = target.low_V
        self.time_s = 0.0
        self.wait_s = target.patience_s
        self._expected = (0.0, math.nan)
        self._noise = 0.0
        self._noise_known_s = -math.inf
        self._looked_s = -math.inf

    def append(self, time_s: float, boost_voltage_V: float, output: float) -> None:
        """Add a sample.

        Raises:
            CommissionError: It is not finite.
        """
        if not (math.isfinite(boost_voltage_V) and math.isfinite(output)):
            raise CommissionError(
                f"output = {output}, {self.target.given.name} = {boost_voltage_V} is not finite"
            )
        self.time_s = time_s
        self.record.append(time_s, boost_voltage_V, output)

    def expect(self, duration_s: float) -> None:
        """Take the length of the phase that begins now."""
        self._expected = (self.time_s, duration_s)

    @property
    def remaining_s(self) -> float:
        """Time to the end of the experiment, NaN before it is known."""
        began_s, duration_s = self._expected
        return max(began_s + duration_s - self.time_s, 0.0)

    @property
    def progress(self) -> float:
        """Share of the present phase, 0 to 1, where it is known."""
        _, duration_s = self._expected
        return 1.0 - self.remaining_s / duration_s if duration_s > 0.0 else self.found

    def wait(self, duration_s: float) -> Steps[None]:
        """Let time pass."""
        until_s = self.time_s + duration_s
        while self.time_s < until_s:
            yield True
            self.look_at_output()

    def look_is_due(self) -> bool:
        """Return whether the band is to be looked at: not with each of many samples."""
        if self.time_s < self._looked_s + _LOOK_SHARE * self.target.patience_s:
            return False
        self._looked_s = self.time_s
        return True

    def look_at_output(self) -> None:
        """Make sure that the output is within its range.

        Raises:
            CommissionError: It is not.
        """
        target = self.target
        output = self.recent(self.smooth_s)
        if output > target.output_max + self.margin(0.0):
            raise CommissionError(
                f"{target.name} = {output:.4g} {target.unit} at {target.given.symbol} = "
                f"{target.given.text(self.voltage_V)} is above load.reference_max = "
                f"{target.output_max:g} {target.unit}"
            )

    def look_at_terminals(self, voltage_V: float, output: float) -> None:
        """Make sure that a battery's terminals stay within their limit.

        Raises:
            CommissionError: They would not.
        """
        onset = self.target.onset
        if onset is None:
            return
        terminal_V = onset.terminal_V(voltage_V, output)
        if terminal_V > onset.terminal_max_V:
            raise CommissionError(
                f"{terminal_V:.4g} V at the terminals would be above load.charge.voltage_max_V = "
                f"{onset.terminal_max_V:g} V: the battery is too full for the experiment"
            )

    def recent(self, duration_s: float) -> float:
        """Return the mean output over the last time, at least of one sample."""
        record = self.record
        if not record.times_s:
            return math.nan
        mean = record.mean(self.time_s - duration_s, self.time_s)
        return mean if math.isfinite(mean) else record.outputs[-1]

    @property
    def smooth_s(self) -> float:
        """Length of the means that are compared with limits."""
        return _SMOOTH_SHARE * self.target.patience_s

    def margin(self, share: float) -> float:
        """Return a share of the movement, and what noise adds to a mean over `smooth_s`."""
        return share * self.target.move + _NOISE_DEVIATIONS * self.standard_error(self.smooth_s)

    def standard_error(self, duration_s: float) -> float:
        """Return the standard error of a mean over the last time."""
        count = self.record.count(self.time_s - duration_s, self.time_s)
        return self.noise / math.sqrt(max(1, count))

    @property
    def noise(self) -> float:
        """Return the standard deviation of the noise of one sample, in the unit of the output."""
        record, patience_s = self.record, self.target.patience_s
        if self.time_s >= self._noise_known_s + _NOISE_SHARE * patience_s:
            self._noise = record.noise(self.time_s - patience_s, self.time_s)
            self._noise_known_s = self.time_s
        return self._noise


# The waits of an experiment: until the load is at rest, and until a battery takes a current.

_DRIFT = 0.1
"""Change of a battery's current that counts as rest, as a share of the movement: its EMF rises."""

_RESTING = 0.05
"""Change over a quarter of the wait, as a share of the movement, of a load at rest."""

_VISIBLE = 0.06
"""Three standard errors of a rest, as a share of the movement, that are waited for."""

_PATIENCES = 60.0
"""Longest wait, in shortest ones."""

_FLOWING = 3.0
"""Current that can be lowered again, in movements."""

_BEHIND = 1.5
"""Distance from the voltage that was asked for, in steps, at which the next step waits."""

_WAIT_SHARE = 0.02
"""Wait after each step, as a share of the shortest wait for a response."""


@dataclass(slots=True)
class Rest:
    """Output at which a load came to rest; NaN until it has.

    Attributes:
        output: Mean output over the last quarter of the wait.
        count: Samples of that quarter.
    """

    output: float = float("nan")
    count: int = 0


def until_rest(course: ExperimentCourse, rest: Rest) -> Steps[None]:
    """Wait until two quarters of the time since now have the same mean.

    Args:
        course: The experiment.
        rest: Takes the rest.

    Raises:
        CommissionError: The load does not come to rest, or its output is too large.
    """
    began_s, start = course.time_s, course.recent(course.smooth_s)
    next_s = began_s + course.wait_s
    while True:
        yield True
        course.look_at_output()
        if course.time_s < next_s:
            continue
        elapsed_s = course.time_s - began_s
        if _is_rest(course, elapsed_s, start, rest):
            return
        next_s = began_s + 1.1 * elapsed_s


def _is_rest(course: ExperimentCourse, elapsed_s: float, start: float, rest: Rest) -> bool:
    """Compare the last two quarters of a wait."""
    target, record, time_s = course.target, course.record, course.time_s
    quarter_s, drift = 0.25 * elapsed_s, 0.0
    if target.onset is not None:
        quarter_s = min(quarter_s, 0.5 * target.patience_s)
        drift = _DRIFT * target.move
    middle = record.mean(time_s - 2.0 * quarter_s, time_s - quarter_s)
    last = record.mean(time_s - quarter_s, time_s)
    error = course.standard_error(quarter_s)
    response = min(abs(last - start), target.move)
    allowed = max(_RESTING * response, 3.0 * error, drift)
    if error <= _VISIBLE / 3.0 * target.move and abs(last - middle) <= allowed:
        rest.output, rest.count = last, record.count(time_s - quarter_s, time_s)
        return True
    if elapsed_s > _PATIENCES * target.patience_s:
        raise CommissionError(
            f"{target.name} does not come to rest within {elapsed_s:.0f} s: it moves by "
            f"{last - middle:.3g} {target.unit} in {quarter_s:.0f} s, and its noise "
            f"is {record.noise(time_s - elapsed_s, time_s):.3g} {target.unit}"
        )
    return False


def find_onset(course: ExperimentCourse) -> Steps[float]:
    """Raise V_c until a current flows that can be lowered again, and return it.

    Raises:
        CommissionError: No current flows, or the voltage at the terminals would be too high.
    """
    target = course.target
    wanted, wait_s = _FLOWING * target.move, _WAIT_SHARE * target.patience_s
    voltage_V = target.low_V
    yield from course.wait(target.patience_s / 4.0)
    while course.recent(wait_s) < wanted:
        if voltage_V >= target.high_V:
            raise CommissionError(
                f"no current: {target.name} = {course.recent(wait_s):.3g} {target.unit} at "
                f"{target.given.text(voltage_V)}, the highest {target.given.symbol}"
            )
        voltage_V = min(voltage_V + target.onset_step_V, target.high_V)
        course.voltage_V = voltage_V
        course.found = (voltage_V - target.low_V) / (target.high_V - target.low_V)
        course.look_at_terminals(voltage_V, course.recent(wait_s))
        yield from _arrive(course, voltage_V)
        yield from course.wait(wait_s)
    return voltage_V


def _arrive(course: ExperimentCourse, voltage_V: float) -> Steps[None]:
    """Wait until the drive has come near a voltage; a command takes its time to reach it."""
    nearly_V = voltage_V - _BEHIND * course.target.onset_step_V
    until_s = course.time_s + course.target.patience_s
    while course.record.voltages_V[-1] < nearly_V and course.time_s < until_s:
        yield True
        course.look_at_output()
