"""The power stage: line, boost pre-regulator, drive that holds its output, coupled dc/dc stage.

The line's frequency drifts as a slow sine, so that a run is the same each time. A sag takes a
fraction off the voltage for a while and ends by itself.

State x = v_bst², for which the stage is linear in its command:

    dx/dt = (2/C)·(k·V_rms² − v·i_boost(v)),   i_boost(v) = G·v − H

k is the line-current scale (line current over line voltage). One call integrates one half line
cycle, averaged over the line. While x moves by less than a tenth of itself, its Taylor series is
summed: with t in half cycles of length T, g = 2TG/C, h = 2TH/C and x = Σ x_n tⁿ, v = Σ v_n tⁿ,

    (n + 1)·x_(n+1) = h·v_n − g·x_n  (+ 2TkV_rms²/C for n = 0),   Σ v_i·v_(n−i) = x_n

Otherwise, as where the load current stops, one fourth-order Runge-Kutta step is taken, with the
cubic through both ends for the middle. The 120 Hz ripple that averaging removes vanishes at the
zero crossing, where the drive samples.

While the line is on, the rectifier's diodes do not let v fall below the line's peak; a capacitor
below it is charged towards it through the precharge resistor.

It follows its reference with a first-order lag, whatever the load draws and the line gives.

From the load's side it is a source N2·v behind R_d. From the boost capacitor's side it draws the
current N2·i, where i is the load current; with a load of electromotive force E and resistance R
that is i_boost(v) = G·v − H with G = N2²/(R_d + R) and H = N2·E/(R_d + R).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

from adaptdrive_sim.parameters import check_quantities, check_range, quantity


class Sample(NamedTuple):
    """Measurements of the drive at the end of a half cycle.

    Attributes:
        tick: Half cycles since the start.
        tick_period_s: Length of the elapsed half cycle.
        boost_voltage_V: v_bst at the zero crossing, where its ripple vanishes.
        line_voltage_V: Line voltage of the elapsed half cycle, rms.
        load_power_W: Mean power from the boost capacitor over the elapsed half cycle.
        output: Regulated quantity with measurement noise.
        load_current_A: Mean load current over the elapsed half cycle.
    """

    tick: int
    tick_period_s: float
    boost_voltage_V: float
    line_voltage_V: float
    load_power_W: float
    output: float
    load_current_A: float


# The ac line.

SAG_MAX_s = 60.0
_DRIFT_rad_s = 2.0 * math.pi / 97.0


@dataclass(frozen=True, slots=True)
class LineParameters:
    """The ac line."""

    frequency_Hz: float = quantity(60.0, "Hz", "mean frequency", 40.0, 70.0)
    drift_Hz: float = quantity(0.0, "Hz", "amplitude of the frequency drift", 0.0, 1.0)
    voltage_V: float = quantity(120.0, "V", "mean voltage, rms", 1.0, 1e3)

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
        self._sag = 0.0
        self._sag_end_s = 0.0

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

    def advance(self) -> None:
        """Enter the next half cycle."""
        own, time_s = self.parameters, self.time_s
        frequency_Hz = own.frequency_Hz + own.drift_Hz * math.sin(_DRIFT_rad_s * time_s)
        if time_s + 0.5 * self.half_cycle_s >= self._sag_end_s:
            self._sag = 0.0
        self.voltage_V = own.voltage_V * (1.0 - self._sag)
        self.half_cycle_s = 0.5 / frequency_Hz
        self.time_s = time_s + self.half_cycle_s


# The boost pre-regulator: a capacitor between the line's rectifier and the dc/dc stage.

_HALF, _THIRD, _QUARTER, _FIFTH = 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0, 1.0 / 5.0

_GENTLE = 0.1
"""Largest change of x within a half cycle for its series, as a share of x."""

_SLOW = 0.5
"""Largest g for the series; v is then right to 2 mV."""

_DISCHARGE_S = 60.0
"""Time constant of the discharge by a resistor: from 450 to 430 V in 3 s."""


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
        voltage_V: Capacitor voltage v, ripple left out.
        mean_voltage_V: Mean voltage over the last step.
        mean_load_W: Mean power into the dc/dc stage over the last step.
        mean_line_W: Mean power from the line over the last step, diode current included.
        has_rectifier: Whether the line's peak is the lowest voltage at rest.
    """

    has_rectifier = True

    def __init__(self, parameters: BoostParameters, voltage_V: float) -> None:
        self.parameters = parameters
        self.squared_V2 = voltage_V * voltage_V
        self.voltage_V = self.mean_voltage_V = voltage_V
        self.mean_load_W = 0.0
        self.mean_line_W = 0.0
        self._rate = 2.0 / parameters.capacitance_F
        self._lowest = -math.inf if parameters.bidirectional else 0.0

    def settle(self, voltage_V: float, load_W: float) -> None:
        """Put the stage at rest at a voltage, with the line supplying the load's power."""
        self.squared_V2 = voltage_V * voltage_V
        self.voltage_V = self.mean_voltage_V = voltage_V
        self.mean_load_W = self.mean_line_W = load_W

    def discharge(self, lowest_V: float, duration_s: float) -> None:
        """Discharge the capacitor by a resistor, down to a voltage.

        Args:
            lowest_V: The voltage; below it nothing happens.
            duration_s: Time of the discharge.
        """
        if self.voltage_V > lowest_V:
            left_V = self.voltage_V * math.exp(-duration_s / _DISCHARGE_S)
            self.voltage_V = max(lowest_V, left_V)
            self.squared_V2 = self.voltage_V * self.voltage_V

    def advance(
        self, current_scale_S: float, line_V: float, load: tuple[float, float], duration_s: float
    ) -> float:
        """Integrate one half line cycle.

        Args:
            current_scale_S: Line-current scale k; negative only acts when bidirectional.
            line_V: Line voltage, rms.
            load: G and H of the load as seen from the capacitor.
            duration_s: Length of the half cycle.

        Returns:
            Voltage at the end, ripple left out.
        """
        conductance_S, offset_A = load
        squared_line = line_V * line_V
        supply_W = current_scale_S * squared_line
        if supply_W < 0.0 and self._lowest == 0.0:
            supply_W = 0.0
        first, floor = self.squared_V2, 2.0 * squared_line
        last, mean_V = self._integrate(supply_W, conductance_S, offset_A, duration_s)
        gained_W = (last - first) / (self._rate * duration_s)
        load_W = supply_W - gained_W
        held = self._rectified(first, floor, duration_s) if last < floor else last
        if held > last:
            last, middle_V = held, math.sqrt(0.5 * (first + held))
            mean_V = (self.voltage_V + 4.0 * middle_V + math.sqrt(held)) / 6.0
            gained_W = (last - first) / (self._rate * duration_s)
            load_W = middle_V * max(self._lowest, conductance_S * middle_V - offset_A)
        self.squared_V2, self.voltage_V = last, math.sqrt(last)
        self.mean_voltage_V = mean_V
        self.mean_load_W = load_W
        self.mean_line_W = load_W + gained_W
        return self.voltage_V

    def _integrate(
        self, supply_W: float, conductance_S: float, offset_A: float, duration_s: float
    ) -> tuple[float, float]:
        """x at the end of a half cycle without diodes, and the mean of v over it."""
        x, v, whole = self.squared_V2, self.voltage_V, self._rate * duration_s
        g, load_W = whole * conductance_S, v * (conductance_S * v - offset_A)
        change = whole * (supply_W - load_W)
        moves = abs(change)
        flows = load_W - conductance_S * moves > self._lowest * v  # all the time
        if flows and moves < _GENTLE * x and g < _SLOW:
            return _sum_series(x, v, change, g, whole * offset_A)
        return self._runge_kutta(x, supply_W, conductance_S, offset_A, duration_s)

    def _runge_kutta(
        self, x: float, supply_W: float, conductance_S: float, offset_A: float, step_s: float
    ) -> tuple[float, float]:
        """The same, whatever happens in between; written out, as it may run for long."""
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
        middle = max(0.0, 0.5 * (x + last) + 0.125 * whole * (p5 - p1))
        return last, (sqrt(x) + 4.0 * sqrt(middle) + v) / 6.0

    def _rectified(self, first: float, floor: float, duration_s: float) -> float:
        """Return the x that the diodes enforce: the line's peak, or the way there from below."""
        if first >= floor:
            return floor
        return floor - (floor - first) * math.exp(-duration_s / self.parameters.precharge_s)


def _sum_series(x: float, v: float, x1: float, g: float, h: float) -> tuple[float, float]:
    """x at the end of a half cycle and the mean of v over it; written out, as nearly all run it.

    Args:
        x: State at the start.
        v: Its square root.
        x1: First term of the series of x.
        g: 2TG/C.
        h: 2TH/C.
    """
    per_v = 0.5 / v
    v1 = x1 * per_v
    x2 = (h * v1 - g * x1) * _HALF
    v2 = (x2 - v1 * v1) * per_v
    x3 = (h * v2 - g * x2) * _THIRD
    v3 = (x3 - 2.0 * v1 * v2) * per_v
    x4 = (h * v3 - g * x3) * _QUARTER
    v4 = (x4 - 2.0 * v1 * v3 - v2 * v2) * per_v
    x5 = (h * v4 - g * x4) * _FIFTH
    mean = v + (v1 * _HALF + (v2 * _THIRD + (v3 * _QUARTER + v4 * _FIFTH)))
    return x + (x1 + (x2 + (x3 + (x4 + x5)))), mean


# The output of a drive that holds it itself: a voltage, a frequency or a torque without a floor.


class HeldOutput(Boost):
    """Takes the place of the boost capacitor, and of the loop that holds its voltage.

    Attributes:
        reference_V: What is asked for, in the drive's unit; 0 for none.
    """

    has_rectifier = False

    def __init__(self, parameters: BoostParameters, lag_s: float) -> None:
        """Begin at 0.

        Args:
            parameters: Whether the load may feed power back.
            lag_s: Time constant.
        """
        super().__init__(parameters, 0.0)
        self.reference_V = 0.0
        self._lag_s = lag_s

    def scale_S(self, reference_V: float, sample: Sample) -> float:
        """Take a reference; there is no line current to scale."""
        del sample
        self.reference_V = reference_V
        return 0.0

    def advance(
        self, current_scale_S: float, line_V: float, load: tuple[float, float], duration_s: float
    ) -> float:
        """Run one half line cycle, as the boost stage does."""
        del current_scale_S, line_V
        conductance_S, offset_A = load
        share = -math.expm1(-duration_s / self._lag_s) if self._lag_s else 1.0
        end_V = self.voltage_V + share * (self.reference_V - self.voltage_V)
        mean_V = 0.5 * (self.voltage_V + end_V)
        self.settle(end_V, mean_V * max(self._lowest, conductance_S * mean_V - offset_A))
        self.mean_voltage_V = mean_V
        return end_V


# The inductively coupled dc/dc stage: an ideal transformer with a droop resistance.


@dataclass(frozen=True, slots=True)
class CouplingParameters:
    """The dc/dc stage."""

    ratio: float = quantity(0.25, "", "secondary volts per volt of v_bst, N2", 0.01, 10.0)
    droop_Ohm: float = quantity(1.0, "Ω", "output resistance of the stage, R_d", 0.0, 100.0)

    def __post_init__(self) -> None:
        check_quantities(self)

    def draw(self, emf_V: float, resistance_Ohm: float) -> tuple[float, float]:
        """Return the load as seen from the boost capacitor.

        Returns:
            Conductance G in siemens and offset current H in ampere: i_boost(v) = G·v − H.
        """
        primary_S = self.ratio / (self.droop_Ohm + resistance_Ohm)
        return primary_S * self.ratio, primary_S * emf_V
