"""V_c as the operator sets it in mode `manual`: a ramp to the value asked for, and its expiry."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ManualVoltage:
    """V_c on its way to the operator's value.

    Attributes:
        start_V: V_c when the value was asked for.
        target_V: The value asked for.
        since_tick: Tick at which it was asked for.
        slew_V: Largest change of V_c in one tick.
        hold_s: Longest time until the next value, None without a limit.
        hold_ticks: The same in ticks.
    """

    start_V: float
    target_V: float
    since_tick: int
    slew_V: float
    hold_s: float | None = None
    hold_ticks: int = 0

    def value(self, tick: int) -> float:
        """Return V_c at a tick, in volts."""
        way_V = self.slew_V * max(0, tick - self.since_tick)
        distance_V = self.target_V - self.start_V
        if abs(distance_V) <= way_V:
            return self.target_V
        return self.start_V + (way_V if distance_V > 0.0 else -way_V)

    def find_cause(self, tick: int) -> str | None:
        """Return why the operator must be taken for lost at a tick, None while there is no reason.

        Args:
            tick: Present tick.
        """
        if self.hold_s is None or tick - self.since_tick <= self.hold_ticks:
            return None
        return f"manual: no new voltage within the {self.hold_s:g} s that its sender had set"
