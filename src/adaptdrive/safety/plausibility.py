"""Measured outputs that no load could have: one that stands still, or that stays too low.

A sensor that is reversed, that dies slowly or whose wire is broken reads low, and the controller
answers with all the power there is. Two limits of a load hold whatever it is:

* It responds. With f = `factor`, a load may have 1/f of the gain K of its model, and lags τ that
  are f times as long or as short, from one moment to the next; a torque or a loss may take a tenth
  of the largest input. The lowest output of all such loads is found by a chain of lags, each
  of which rises as slowly and falls as fast as it may:

      x' = (level - x) / (f·τ) where level > x, else f·(level - x) / τ
      level = K/f · (u - 0.1 u_max), or the x of the lag before

* It stores. Its output cannot fall faster than the shortest lag lets it.

The current of a battery depends on its own voltage too, which is not known. But the drive measures
the power that it gives, and that over the boost voltage is the current. A current can fall at once.

A sensor may freeze while its messages come with live counters. An honest value may stand still
too: at rest, where its last digit is coarse. The input distinguishes them. From the moment at
which the output came to stand, the model of the load predicts how far the *change* of the input
since then must have moved it:

    Δy = G(s) Δu,   Δu = u - ū(then)

The mean input ū of the last third of a lag stands for the input: noise may have it at one of its
limits at that moment.

An honest value that was to move by many of its digits has moved by one at least; a frozen one has
not. The input as such does not matter, so that neither a wrong gain of the model nor a constant
load makes an output suspicious that is at rest.

An output that is derived from several values moves as long as one of them does. So each of those
that the load moves is watched by itself.
"""

import math
from dataclasses import dataclass, field
from typing import Protocol

from adaptdrive.control.loads.load import to_input
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.quantity import Display


@dataclass(frozen=True, slots=True)
class OutputModel:
    """Model of the load by which a watch judges its output.

    Attributes:
        display: Unit of the output for people, for the text of the trip.
        gain: Change of the output at rest per unit of the input.
        input_gain: u = gain · v_bst^exponent.
        input_exponent: 1 or 2.
        lags_s: Time constants between input and output.
        output_name: Name of the output, as above.
        factor: Multiple of a lag with which a stage may rise, and part of it with which it may
            fall.
        by_power: Whether the input is the power over the boost voltage, and stores nothing.
    """

    display: Display
    gain: float
    input_gain: float
    input_exponent: int
    lags_s: tuple[float, ...]
    output_name: str = field(default="output", kw_only=True)
    factor: float = field(default=1.0, kw_only=True)
    by_power: bool = field(default=False, kw_only=True)

    def input(self, reading: Reading) -> float:
        """Return the input u at a reading."""
        if self.by_power:
            return reading.load_power_W / max(reading.boost_voltage_V, 1.0)
        return to_input(reading.boost_voltage_V, self.input_gain, self.input_exponent)

    def pass_on(self, stages: list[float], level: float, period_s: float) -> float:
        """Pass a level through the chain of lags; return the lowest that may come out of it.

        Args:
            stages: Output of each lag; overwritten.
            level: Input of the first one.
            period_s: Time for which it has been there.
        """
        falls = 0.0 if self.by_power else 1.0 / self.factor
        for number, lag_s in enumerate(self.lags_s):
            stage = stages[number]
            slow_s = lag_s * (self.factor if level > stage else falls)
            if slow_s > 0.0:
                level = stage - (level - stage) * math.expm1(-period_s / slow_s)
            stages[number] = level
        return level


class Watch(Protocol):
    """Compares the readings of a running drive with each other, one after the other."""

    def forget(self) -> None:
        """Begin anew: the drive is not running."""

    def find_cause(self, reading: Reading) -> Trip | None:
        """Return the cause of a trip, None for none.

        Args:
            reading: The newest, again where there is no newer one.
        """


# An output that is lower than any load of the kind would have it after what it was fed with.

_LOAD_SHARE = 0.1
"""Torque or loss not in the model, as a share of the largest input: 40 V of 400 V for a motor."""

_MARGIN = 0.05
"""Distance below the lowest output that trips, as a share of the set-point range: seven standard
deviations of a noise of 5 %, smoothed."""

_SMOOTHING_S = 0.2
"""Time constant of the smoothed output, against the noise of single readings."""

_FALL_MARGIN = 0.15
"""The same for a fall, which is compared with the highest of many noisy values."""

_FASTEST = 10.0
"""Permitted ratio of the model's shortest lag to the load's: a bath is emptied, or filled with
cold water, faster than it cools."""


@dataclass(frozen=True, slots=True)
class ResponseLimits(OutputModel):
    """The load with the lowest plausible output.

    Attributes:
        input_max: Largest input.
        reference_range: Highest less lowest set-point.
    """

    input_max: float
    reference_range: float

    @property
    def margin(self) -> float:
        """Distance below the lowest output at which the drive trips."""
        return _MARGIN * self.reference_range

    @property
    def fastest_s(self) -> float:
        """Shortest time constant with which an output that is stored may fall."""
        return min(self.lags_s) / _FASTEST

    def at_rest(self, input_value: float) -> float:
        """Return the lowest output at rest.

        Args:
            input_value: The constant input.
        """
        return max(0.0, self.gain / self.factor * (input_value - _LOAD_SHARE * self.input_max))


class Response:
    """Watches the output of a running drive."""

    def __init__(self, limits: ResponseLimits) -> None:
        self._limits = limits
        self._arrival_s = math.nan
        self._output = self._highest = 0.0
        self._stages = [0.0] * len(limits.lags_s)

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._arrival_s = math.nan

    def find_cause(self, reading: Reading) -> Trip | None:
        """Return why the output is too low to be true, None while it is not.

        Args:
            reading: The newest, again where there is no newer one.
        """
        if math.isnan(self._arrival_s):
            self._begin(reading)
        period_s, self._arrival_s = reading.arrival_s - self._arrival_s, reading.arrival_s
        if period_s <= 0.0:
            return None
        self._output += (reading.output - self._output) * -math.expm1(-period_s / _SMOOTHING_S)
        level = self._limits.at_rest(self._limits.input(reading))
        lowest = self._limits.pass_on(self._stages, level, period_s)
        return self._low(lowest) or self._fallen(period_s)

    def _begin(self, reading: Reading) -> None:
        """Take the present output as it is: a bath may be colder than its inflow."""
        self._arrival_s = reading.arrival_s
        self._output = self._highest = reading.output
        self._stages = [min(0.0, reading.output)] * len(self._stages)

    def _low(self, lowest: float) -> Trip | None:
        limits = self._limits
        if self._output >= lowest - limits.margin:
            return None
        return Trip(
            TripKind.OUTPUT_TOO_LOW,
            f"no response: {limits.output_name} = {self._value(self._output)}, and with this input "
            f"must be above {self._value(lowest)}: is the sensor reversed or its wire broken, is "
            "the load blocked?",
        )

    def _fallen(self, period_s: float) -> Trip | None:
        """Compare with the fastest fall from the highest output so far."""
        limits = self._limits
        if limits.by_power:
            return None
        self._highest = max(self._highest * math.exp(-period_s / limits.fastest_s), self._output)
        if self._output >= self._highest - _FALL_MARGIN * limits.reference_range:
            return None
        return Trip(
            TripKind.OUTPUT_FELL,
            f"no response: {limits.output_name} fell to {self._value(self._output)}, and the load "
            f"cannot have fallen below {self._value(self._highest)} yet: is the sensor's wire "
            "broken?",
        )

    def _value(self, output: float) -> str:
        return self._limits.display.text(output, ".3g")


# A measured output that stands still while it cannot.

_DIGITS = 20.0
"""Digits of a coarse value that it must have been moved by. Where a movement turns round, it stands
on one digit while the input is already taking it elsewhere."""

_COARSEST = 3.0
"""Distances that a coarse value must have been moved by at the most, where its digit is not known:
the smallest change that was seen may be larger than a digit."""

_MEAN_SHARE = 1.0 / 3.0
"""Time constant of the mean input, as a share of the longest lag: a whole lag would be the model's
own movement, which ends late where the load has less inertia than its model."""


@dataclass(frozen=True, slots=True)
class StillnessLimits(OutputModel):
    """Limits of the time that the output may stand still.

    Attributes:
        distance: Predicted movement that must show; infinite for no limit.
        longest_s: Longest time without any change, infinite for no limit.
        inputs: Names of the measured values that the output is derived from and the load moves.
        resolution: Last digit of the output where it is known, 0 where it is not.
    """

    distance: float
    longest_s: float
    inputs: tuple[str, ...] = ()
    resolution: float = 0.0


class StillnessWatch:
    """Watches the output of a running drive, and what it is derived from."""

    def __init__(self, limits: StillnessLimits) -> None:
        self._limits = limits
        self._output = Stillness(limits, f"{limits.output_name} stands", limits.display)
        self._inputs = {
            name: Stillness(limits, f"{name}, from which {limits.output_name} is derived, stands")
            for name in limits.inputs
        }

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._output.forget()
        for one in self._inputs.values():
            one.forget()

    def find_cause(self, reading: Reading) -> Trip | None:
        """Return the cause of a trip, None for none.

        Args:
            reading: The newest, again where there is no newer one.
        """
        given, arrival_s = self._limits.input(reading), reading.arrival_s
        cause = self._output.advance(reading.output, given, arrival_s)
        for name, one in self._inputs.items():
            value = reading.other.get(name, math.nan)
            cause = one.advance(value, given, arrival_s) or cause
        return cause


_PLAIN = Display()


class Stillness:
    """Watches one value of a running drive."""

    def __init__(
        self, limits: StillnessLimits, stands: str = "output stands", display: Display = _PLAIN
    ) -> None:
        """Watch nothing yet.

        Args:
            limits: When the value has stood still for too long.
            stands: Name and verb, for the text of the trip.
            display: Unit of the value for people, as above.
        """
        self._limits = limits
        self._stands = f"stuck: {stands} at exactly"
        self._display = display
        self._output = math.nan
        self._digit = math.inf
        self._since_s = self._last_s = 0.0
        self._input = self._mean = 0.0
        self._mean_s = _MEAN_SHARE * max(limits.lags_s)
        self._stages = [0.0] * len(limits.lags_s)

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._output = math.nan

    def advance(self, output: float, input_value: float, arrival_s: float) -> Trip | None:
        """Take the newest measurement, again where there is no newer one.

        Args:
            output: The watched value.
            input_value: Input of the load.
            arrival_s: When they were measured.

        Returns:
            Reason to reject the value, None for no reason.
        """
        limits = self._limits
        if math.isnan(self._output):
            self._mean, self._last_s = input_value, arrival_s
        period_s, self._last_s = arrival_s - self._last_s, arrival_s
        self._mean += (input_value - self._mean) * -math.expm1(-period_s / self._mean_s)
        if output != self._output:
            self._digit = min(self._digit, abs(output - self._output))
            self._output, self._input, self._since_s = output, self._mean, arrival_s
            self._stages = [0.0] * len(self._stages)
            return None
        moved = limits.pass_on(self._stages, limits.gain * (input_value - self._input), period_s)
        still_s = arrival_s - self._since_s
        if abs(moved) > self._distance:
            by = limits.display.change.text(moved, ".3g")
            distance = f"{limits.output_name} should have moved by {by}"
            return Trip(TripKind.OUTPUT_FROZEN, f"{self._text(still_s)}, and {distance}")
        if still_s > limits.longest_s:
            return Trip(TripKind.OUTPUT_FROZEN, self._text(still_s))
        return None

    @property
    def _distance(self) -> float:
        """Predicted movement of which an honest value shows one digit at least."""
        distance = self._limits.distance
        if self._limits.resolution > 0.0:
            return max(distance, _DIGITS * self._limits.resolution)
        if self._digit == math.inf:  # it has never changed
            return distance
        return max(distance, min(_DIGITS * self._digit, _COARSEST * distance))

    def _text(self, still_s: float) -> str:
        value = self._display.text(self._output, ".6g")
        return f"{self._stands} {value} for {still_s:.3g} s"
