"""The boost pre-regulator: a capacitor between the line's rectifier and the dc/dc stage.

State x = v_bst², for which the stage is linear in its command:

    dx/dt = (2/C)·(k·V_rms² − v·i_boost(v)),   i_boost(v) = G·v − H

k is the line-current scale (line current over line voltage). One call integrates one half line
cycle, averaged over the line: one fourth-order Runge-Kutta step, since the load's 2G/C is only
about 31 1/s, with the cubic through both ends for the middle. The 120 Hz ripple that averaging
removes comes back as an analytic term: with the input power P·(1 − cos 2ωt), v carries
−P·sin(2ωt)/(2·C·ω·v), which vanishes at the zero crossing.

While the line is on, the rectifier's diodes do not let v fall below the line's peak; a capacitor
below it is charged towards it through the precharge resistor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive_sim.parameters import check_quantities, quantity


@dataclass(frozen=True, slots=True)
class BoostParameters:
    """The boost stage."""

    capacitance_F: float = quantity(1.0e-3, "F", "boost capacitor, C", 1e-5, 1.0)
    precharge_s: float = quantity(0.05, "s", "time constant of the precharge", 1e-3, 10.0)
    bidirectional: bool = False

    def __post_init__(self) -> None:
        check_quantities(self)


class Boost:
    """The capacitor and the rectifier that feeds it.

    Attributes:
        squared_V2: State x = v².
        mean_voltage_V: Mean voltage over the last step.
        mean_load_W: Mean power into the dc/dc stage over the last step.
        mean_line_W: Mean power from the line over the last step, diode current included.
    """

    def __init__(self, parameters: BoostParameters, voltage_V: float) -> None:
        self.parameters = parameters
        self.squared_V2 = voltage_V * voltage_V
        self.mean_voltage_V = voltage_V
        self.mean_load_W = 0.0
        self.mean_line_W = 0.0
        self._rate = 2.0 / parameters.capacitance_F
        self._lowest = -math.inf if parameters.bidirectional else 0.0

    @property
    def voltage_V(self) -> float:
        """Capacitor voltage, ripple left out."""
        return math.sqrt(self.squared_V2)

    def settle(self, voltage_V: float, load_W: float) -> None:
        """Put the stage at rest at a voltage, with the line supplying the load's power."""
        self.squared_V2 = voltage_V * voltage_V
        self.mean_voltage_V = voltage_V
        self.mean_load_W = self.mean_line_W = load_W

    def advance(
        self,
        current_scale_S: float,
        line_V: float,
        conductance_S: float,
        offset_A: float,
        duration_s: float,
    ) -> float:
        """Integrate one half line cycle.

        Args:
            current_scale_S: Line-current scale k; negative only acts when bidirectional.
            line_V: Line voltage, rms.
            conductance_S: G of the load as seen from the capacitor.
            offset_A: H of the load as seen from the capacitor.
            duration_s: Length of the half cycle.

        Returns:
            Voltage at the end, ripple left out.
        """
        squared_line = line_V * line_V
        supply_W = current_scale_S * squared_line
        if supply_W < 0.0 and self._lowest == 0.0:
            supply_W = 0.0
        first = self.squared_V2
        middle, last = self._integrate(first, supply_W, conductance_S, offset_A, duration_s)
        load_W = supply_W - (last - first) / (self._rate * duration_s)
        floor = 2.0 * squared_line
        held = self._rectified(first, floor, duration_s) if last < floor else last
        if held > last:
            last, middle = held, 0.5 * (first + held)
            mean_V = math.sqrt(middle)
            load_W = mean_V * max(self._lowest, conductance_S * mean_V - offset_A)
        end_V = math.sqrt(last)
        self.squared_V2 = last
        self.mean_voltage_V = (math.sqrt(first) + 4.0 * math.sqrt(middle) + end_V) / 6.0
        self.mean_load_W = load_W
        self.mean_line_W = load_W + (last - first) / (self._rate * duration_s)
        return end_V

    def ripple_V(self, phase_rad: float, duration_s: float) -> float:
        """The 120 Hz ripple at a phase of the line's double frequency (0 at zero crossings)."""
        line_rad_s = math.pi / duration_s
        swing = self.parameters.capacitance_F * 2.0 * line_rad_s * max(self.voltage_V, 1.0)
        return -self.mean_line_W * math.sin(phase_rad) / swing

    def _integrate(
        self, x: float, supply_W: float, conductance_S: float, offset_A: float, step_s: float
    ) -> tuple[float, float]:
        """x in the middle and at the end of a step; written out, as every half cycle runs it."""
        sqrt, lowest = math.sqrt, self._lowest
        whole = self._rate * step_s
        half = 0.5 * whole
        supplied = half * supply_W
        v = sqrt(x)
        i = conductance_S * v - offset_A
        p1 = v * (i if i > lowest else lowest)
        v = sqrt(abs(x + supplied - half * p1))
        i = conductance_S * v - offset_A
        p2 = v * (i if i > lowest else lowest)
        v = sqrt(abs(x + supplied - half * p2))
        i = conductance_S * v - offset_A
        p3 = v * (i if i > lowest else lowest)
        v = sqrt(abs(x + 2.0 * supplied - whole * p3))
        i = conductance_S * v - offset_A
        p4 = v * (i if i > lowest else lowest)
        drawn_W = (p1 + 2.0 * (p2 + p3) + p4) / 6.0
        last = max(0.0, x + whole * (supply_W - drawn_W))
        v = sqrt(last)
        i = conductance_S * v - offset_A
        p5 = v * (i if i > lowest else lowest)
        return max(0.0, 0.5 * (x + last) + 0.125 * whole * (p5 - p1)), last

    def _rectified(self, first: float, floor: float, duration_s: float) -> float:
        """Where the diodes keep x: at the line's peak, or on the way there from below."""
        if first >= floor:
            return floor
        return floor - (floor - first) * math.exp(-duration_s / self.parameters.precharge_s)
