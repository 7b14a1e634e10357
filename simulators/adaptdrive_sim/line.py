"""The ac line: frequency that drifts, voltage that wanders, sags.

Drift and wander are slow sines with periods of their own, so that a run is the same each time.
A sag takes a fraction off the voltage for a while and ends by itself.
"""

import math
from dataclasses import dataclass
from typing import Self

from adaptdrive_sim.parameters import check_quantities, check_range, quantity

SAG_MAX_s = 60.0


@dataclass(frozen=True, slots=True)
class LineParameters:
    """The ac line."""

    frequency_Hz: float = quantity(60.0, "Hz", "mean frequency", 40.0, 70.0)
    drift_Hz: float = quantity(0.0, "Hz", "amplitude of the frequency drift", 0.0, 1.0)
    drift_period_s: float = quantity(97.0, "s", "period of the frequency drift", 1.0, 1e6)
    voltage_V: float = quantity(120.0, "V", "mean voltage, rms", 1.0, 1e3)
    wander: float = quantity(0.0, "", "amplitude of the voltage's wander, fraction", 0.0, 0.3)
    wander_period_s: float = quantity(41.0, "s", "period of the voltage's wander", 1.0, 1e6)

    def __post_init__(self) -> None:
        check_quantities(self)

    @classmethod
    def steady(cls, share: float, frequency_Hz: float) -> Self:
        """Return a line that does not change.

        Args:
            share: Its voltage as a share of the nominal one.
            frequency_Hz: Its frequency.
        """
        return cls(voltage_V=cls().voltage_V * share, frequency_Hz=frequency_Hz)


class Line:
    """The line during one half cycle after the other.

    Attributes:
        time_s: Start of the coming half cycle, since the line was made.
        voltage_V: Voltage of the last half cycle, rms.
        half_cycle_s: Length of the last half cycle.
    """

    def __init__(self, parameters: LineParameters) -> None:
        self.parameters = parameters
        self.time_s = 0.0
        self.voltage_V = parameters.voltage_V
        self.half_cycle_s = 0.5 / parameters.frequency_Hz
        self._steady = parameters.drift_Hz == 0.0 and parameters.wander == 0.0
        self._drift_rad_s = 2.0 * math.pi / parameters.drift_period_s
        self._wander_rad_s = 2.0 * math.pi / parameters.wander_period_s
        self._sag = 0.0
        self._sag_end_s = 0.0
        self._sagging = False

    def sag(self, fraction: float, duration_s: float) -> None:
        """Take a fraction off the voltage from the next half cycle on.

        Args:
            fraction: 0 for none, 1 for a line that is gone.
            duration_s: How long it lasts, rounded to half cycles; a new sag replaces one that
                is under way.
        """
        check_range("sag", fraction, 0.0, 1.0, "")
        check_range("duration_s", duration_s, 0.0, SAG_MAX_s, "s")
        self._sag = fraction
        self._sag_end_s = self.time_s + duration_s
        self._sagging = True

    def advance(self) -> None:
        """Enter the next half cycle."""
        if self._steady and not self._sagging:
            self.time_s += self.half_cycle_s
            return
        own, time_s = self.parameters, self.time_s
        frequency_Hz = own.frequency_Hz + own.drift_Hz * math.sin(self._drift_rad_s * time_s)
        wander = own.wander * math.sin(self._wander_rad_s * time_s)
        if self._sagging and time_s + 0.5 * self.half_cycle_s >= self._sag_end_s:
            self._sag, self._sagging = 0.0, False
        self.voltage_V = own.voltage_V * (1.0 + wander) * (1.0 - self._sag)
        self.half_cycle_s = 0.5 / frequency_Hz
        self.time_s = time_s + self.half_cycle_s
