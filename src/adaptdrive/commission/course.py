"""The course of an experiment: its phases and samples, its limits, and the voltage it asks for."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from adaptdrive.commission.samples import Samples
from adaptdrive.commission.target import Target
from adaptdrive.util.errors import CommissionError

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
