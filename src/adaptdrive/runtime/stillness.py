"""A measured output that stands still while it cannot.

A sensor may freeze while its messages go on with live counters. An honest value may stand still
too: at rest, where its last digit is coarse. What tells them apart is the input. From the moment at
which the output came to stand, the model of the load predicts how far the *change* of the input
since then must have moved it:

    Δy = G(s) Δu,   Δu = u - u(then)

An honest value that was to move by many of its digits has moved by one at least; a frozen one has
not. The input as such does not matter, so that neither a wrong gain of the model nor a constant
load makes an output suspicious that is at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StillnessLimits:
    """When the output has stood still for too long.

    Attributes:
        unit: Unit of the output, for the text of the trip.
        gain: Change of the output at rest per unit of the input.
        input_gain: u = gain · v_bst^exponent.
        input_exponent: 1 or 2.
        lags_s: Time constants between input and output.
        distance: Predicted movement that must show; infinite for no limit.
        longest_s: Longest time without any change, infinite for no limit.
    """

    unit: str
    gain: float
    input_gain: float
    input_exponent: int
    lags_s: tuple[float, ...]
    distance: float
    longest_s: float


class Stillness:
    """Watches the output of a running drive."""

    def __init__(self, limits: StillnessLimits) -> None:
        self._limits = limits
        self._output = math.nan
        self._since_s = self._last_s = 0.0
        self._input = 0.0
        self._stages = [0.0] * len(limits.lags_s)

    def forget(self) -> None:
        """Begin anew: the drive is not running."""
        self._output = math.nan

    def advance(self, output: float, boost_voltage_V: float, arrival_s: float) -> str | None:
        """Take the newest measurement, again where there is no newer one.

        Args:
            output: The regulated quantity.
            boost_voltage_V: Boost voltage.
            arrival_s: When they were measured.

        Returns:
            Why the output is not believed any more, or None.
        """
        limits = self._limits
        input_value = limits.input_gain * boost_voltage_V**limits.input_exponent
        if output != self._output:
            self._output, self._input = output, input_value
            self._since_s = self._last_s = arrival_s
            self._stages = [0.0] * len(self._stages)
            return None
        moved = self._predict(input_value - self._input, arrival_s - self._last_s)
        self._last_s = arrival_s
        still_s = arrival_s - self._since_s
        if abs(moved) > limits.distance:
            return f"{self._stands(still_s)}, and should have moved by {moved:.3g} {limits.unit}"
        return self._stands(still_s) if still_s > limits.longest_s else None

    def _stands(self, still_s: float) -> str:
        value = f"{self._output:.6g} {self._limits.unit}"
        return f"stuck: output stands at exactly {value} for {still_s:.3g} s"

    def _predict(self, change: float, period_s: float) -> float:
        """How far the output has moved since it came to stand, by the model."""
        level = self._limits.gain * change
        for number, lag_s in enumerate(self._limits.lags_s):
            self._stages[number] += (level - self._stages[number]) * -math.expm1(-period_s / lag_s)
            level = self._stages[number]
        return level
