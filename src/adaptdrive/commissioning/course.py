"""The course of an experiment: its limits, samples and phases, and the voltage it asks for."""

from __future__ import annotations

import bisect
import itertools
import math
import statistics
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

from adaptdrive.app.loads import build_load
from adaptdrive.config.load import BatterySection
from adaptdrive.config.root import Configuration
from adaptdrive.control.loads.load import to_input, to_voltage
from adaptdrive.util.errors import CommissionError
from adaptdrive.util.quantity import BOOST, Given

# Limits of an experiment: the drive's, the output's, and the movement that was asked for.

_ONSET_SHARE = 0.5
"""Share of the movement that one step may bring while the onset of the current is looked for."""

_FINEST_STEP = 1.0e-3
"""Share of the voltage range, for a dc/dc stage without a known resistance."""


@dataclass(frozen=True, slots=True)
class Target:
    """Limits of an experiment, and the structure of its load.

    Attributes:
        low_V: Lowest V_c, at which the load rests: not below 0.
        high_V: Highest V_c.
        output_max: Highest output that the experiment leads to.
        move: Movement of the output that the experiment aims at.
        first_gain: Guess of the output's movement per unit of the load's input.
        input_gain: u = gain · v^exponent.
        input_exponent: 1 or 2.
        patience_s: Shortest wait for a response.
        name: Name of the output, for people.
        unit: Its unit.
        battery: For a battery, which takes no current below its own voltage: its section.
        given: Name and unit of what the drive is commanded, and gives.
    """

    low_V: float
    high_V: float
    output_max: float
    move: float
    first_gain: float
    input_gain: float
    input_exponent: int
    patience_s: float
    name: str
    unit: str
    battery: BatterySection | None = None
    given: Given = BOOST

    def to_input(self, voltage_V: float) -> float:
        """Return the load's input at a boost voltage."""
        return to_input(voltage_V, self.input_gain, self.input_exponent)

    def raised_V(self, voltage_V: float, step: float) -> float:
        """Return the voltage at which the load's input is a step higher, within the limits."""
        raised_V = to_voltage(self.to_input(voltage_V) + step, self.input_gain, self.input_exponent)
        return min(max(raised_V, self.low_V), self.high_V)

    def middle_V(self, low_V: float, high_V: float) -> float:
        """Return the voltage whose input is in the middle between those of two others."""
        middle = 0.5 * (self.to_input(low_V) + self.to_input(high_V))
        return to_voltage(middle, self.input_gain, self.input_exponent)

    @property
    def onset_step_V(self) -> float:
        """Step of V_c that raises a battery's current by less than the movement."""
        if self.battery is None or not self.battery.model.droop_Ohm > 0.0:
            return _FINEST_STEP * (self.high_V - self.low_V)
        model = self.battery.model
        return _ONSET_SHARE * self.move * model.droop_Ohm / model.turns_ratio


def build_target(
    configuration: Configuration, move_share: float, patience_s: float | None = None
) -> Target:
    """Return the limits of an experiment on a configured drive.

    Args:
        configuration: The drive; its `[load.model]` is used for what belongs to the dc/dc stage.
        move_share: Movement of the output as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.
    """
    section, limits = configuration.load, configuration.drive.limits
    load, high_V = build_load(configuration), limits.boost_reference_max_V
    low_V = max(limits.boost_reference_min_V, 0.0)  # a negative one would drive the load backwards
    ends = [to_input(one, load.input_gain, load.input_exponent) for one in (low_V, high_V)]
    span = section.reference_max - section.reference_min
    return Target(
        low_V=low_V,
        high_V=high_V,
        output_max=section.reference_max,
        move=move_share * span,
        first_gain=span / (ends[1] - ends[0]),
        input_gain=load.input_gain,
        input_exponent=load.input_exponent,
        patience_s=section.traits.patience_s if patience_s is None else patience_s,
        name=section.output_name,
        unit=section.output_unit,
        battery=section if isinstance(section, BatterySection) else None,
        given=configuration.drive.given,
    )


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

    def mean(self, from_s: float = -math.inf, to_s: float = math.inf) -> float:
        """Return the mean output between two times, NaN where there is no sample."""
        first, last = bisect.bisect(self.times_s, from_s), bisect.bisect(self.times_s, to_s)
        return (self.sums[last] - self.sums[first]) / (last - first) if last > first else math.nan

    def reached_s(self, voltage_V: float, from_s: float) -> float:
        """Return when the boost voltage first reached a value after a time; that time if never."""
        for number in range(bisect.bisect(self.times_s, from_s), len(self.times_s)):
            if self.voltages_V[number] >= voltage_V:
                return self.times_s[number]
        return from_s

    def noise(self, from_s: float = -math.inf, to_s: float = math.inf) -> float:
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
        resolution = self.resolution()
        return resolution if resolution > self.noise() else 0.0


# The course of an experiment: its phases and samples, its limits, and the voltage it asks for.

Result = TypeVar("Result")
Steps = Generator[bool, None, Result]
"""A phase: it advances with each sample, and ends with a result."""


class Phase(StrEnum):
    """Part of an experiment."""

    REST = "waiting for rest at the lowest voltage"
    ONSET = "raising the voltage until a current flows"
    CLIMB = "looking for the step that moves the output visibly"
    BACK = "taking the voltage back: the output would move too far"
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
    """An experiment that is fed with samples; its phases share this state.

    Attributes:
        target: Limits, and the movement that was asked for.
        record: All samples.
        phase: Where the experiment is.
        found: Share of the range in which the onset of a current is looked for, 0 to 1.
        voltage_V: V_c that is asked for.
        time_s: Time of the last sample.
        wait_s: Shortest wait for rest: the patience, less once the load has been seen to respond.
        rest: Mean output over the last quarter of the wait after which the load came to rest; NaN
            until it has.
        rest_samples: Samples of that quarter.
        outcome: The result, None before the end of the climb.
    """

    def __init__(self, target: Target, phases: Callable[[ExperimentCourse], Steps[None]]) -> None:
        """Begin at the lowest V_c.

        Args:
            target: Limits, and the movement that was asked for.
            phases: All phases one after the other, a step for each sample.
        """
        self.target = target
        self.record = Samples()
        self.phase = Phase.REST
        self.found = 0.0
        self.voltage_V = target.low_V
        self.time_s = 0.0
        self.wait_s = target.patience_s
        self.rest = math.nan
        self.rest_samples = 0
        self.outcome: Outcome | None = None
        self._steps = phases(self)
        self._expected = (0.0, math.nan)
        self._noise, self._noise_known_s = 0.0, -math.inf
        self._looked_s = -math.inf

    def take(self, time_s: float, boost_voltage_V: float, output: float) -> float:
        """Take a sample and return V_c.

        Args:
            time_s: Its time.
            boost_voltage_V: Boost voltage.
            output: Output.

        Raises:
            CommissionError: The experiment cannot continue; V_c must go to the safe state.
        """
        if not (math.isfinite(boost_voltage_V) and math.isfinite(output)):
            raise CommissionError(
                f"output = {output}, {self.target.given.name} = {boost_voltage_V} is not finite"
            )
        self.time_s = time_s
        self.record.append(time_s, boost_voltage_V, output)
        if not self.done and next(self._steps, None) is None:
            self.phase = Phase.DONE
        return self.voltage_V

    @property
    def done(self) -> bool:
        """True when the test is complete."""
        return self.phase is Phase.DONE

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
        battery = self.target.battery
        if battery is None:
            return
        highest_V = battery.charge.voltage_max_V
        terminal_V = battery.model.turns_ratio * voltage_V - battery.model.droop_Ohm * output
        if terminal_V > highest_V:
            raise CommissionError(
                f"{terminal_V:.4g} V at the terminals would be above load.charge.voltage_max_V = "
                f"{highest_V:g} V: the battery is too full for the experiment"
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
