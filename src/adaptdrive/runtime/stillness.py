"""A measured output that stands still while it cannot.

A sensor may freeze while its messages come with live counters. An honest value may stand still
too: at rest, where its last digit is coarse. The input distinguishes them. From the moment at
which the output came to stand, the model of the load predicts how far the *change* of the input
since then must have moved it:

    Δy = G(s) Δu,   Δu = u - u(then)

An honest value that was to move by many of its digits has moved by one at least; a frozen one has
not. The input as such does not matter, so that neither a wrong gain of the model nor a constant
load makes an output suspicious that is at rest.

An output that is derived from several values moves as long as one of them does. So each of those
that the load moves is watched by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.devices.port import Reading
from adaptdrive.runtime.interlocks import OutputModel

_DIGITS = 20.0
"""Digits of a coarse value that it must have been moved by. Where a movement turns round, it stands
on one digit while the input is already taking it elsewhere."""

_COARSEST = 3.0
"""Distances that a coarse value must have been moved by at the most, where its digit is not known:
the smallest change that was seen may be larger than a digit."""


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
        self._output = Stillness(limits, f"{limits.output_name} stands", limits.output_unit)
        self._inputs = {
            name: Stillness(limits, f"{name}, from which {limits.output_name} is derived, stands")
            for name in limits.inputs
        }

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._output.forget()
        for one in self._inputs.values():
            one.forget()

    def find_cause(self, reading: Reading) -> str | None:
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


class Stillness:
    """Watches one value of a running drive."""

    def __init__(
        self, limits: StillnessLimits, stands: str = "output stands", unit: str = ""
    ) -> None:
        """Watch nothing yet.

        Args:
            limits: When the value has stood still for too long.
            stands: Name and verb, for the text of the trip.
            unit: Unit of the value, as above.
        """
        self._limits = limits
        self._stands = f"stuck: {stands} at exactly"
        self._unit = f" {unit}" if unit else ""
        self._output = math.nan
        self._digit = math.inf
        self._since_s = self._last_s = 0.0
        self._input = 0.0
        self._stages = [0.0] * len(limits.lags_s)

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._output = math.nan

    def advance(self, output: float, input_value: float, arrival_s: float) -> str | None:
        """Take the newest measurement, again where there is no newer one.

        Args:
            output: The watched value.
            input_value: Input of the load.
            arrival_s: When they were measured.

        Returns:
            Reason to reject the value, None for no reason.
        """
        limits = self._limits
        if output != self._output:
            self._digit = min(self._digit, abs(output - self._output))
            self._output, self._input = output, input_value
            self._since_s = self._last_s = arrival_s
            self._stages = [0.0] * len(self._stages)
            return None
        level, period_s = limits.gain * (input_value - self._input), arrival_s - self._last_s
        moved = limits.pass_on(self._stages, level, period_s)
        self._last_s = arrival_s
        still_s = arrival_s - self._since_s
        if abs(moved) > self._distance:
            distance = f"{limits.output_name} should have moved by {moved:.3g} {limits.output_unit}"
            return f"{self._text(still_s)}, and {distance}"
        return self._text(still_s) if still_s > limits.longest_s else None

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
        return f"{self._stands} {self._output:.6g}{self._unit} for {still_s:.3g} s"
