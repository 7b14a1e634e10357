"""A stirred bath with an immersion heater, a constant cold inflow and a drain of movable level.

With T the temperature above that of the inflow, m the mass in the bath and q the mass flow in:

    m·c·dT/dt = p − q·c·T = p − T/R,   R = 1/(q·c),   p = R_h·(V/(R_d + R_h))²

This also holds while the level moves: what flows in is at the datum temperature and what flows
out is at T, so that the outflow, whatever it is, changes the heat in the bath and its mass alike.
With m linear in time the excess over p·R falls by (m0/m1)^(1/(R·c·dm/dt)), which is exact.

Where the temperature of the inflow drifts, by s(t) from that at the start, T stays the temperature
above that at the start, and rests at p·R + s. The resistance of a heater that ages rises steadily.
"""

import math
from dataclasses import dataclass

from adaptdrive_sim.parameters import check_quantities, check_range, quantity

HEAT_J_per_kgK = 4186.0
GALLON_kg = 3.785411784
INFLOW_K = 285.0
VOLUME_MIN_gal = 0.05
VOLUME_MAX_gal = 100.0
FILLING_MAX_s = 86_400.0


@dataclass(frozen=True, slots=True)
class BathParameters:
    """Heater and water."""

    heater_Ohm: float = quantity(7.87, "Ω", "immersion heater, R_h", 0.1, 1e3)
    inflow_L_per_min: float = quantity(0.681, "L/min", "cold water flowing in", 0.01, 100.0)
    volume_gal: float = quantity(0.6, "US gal", "initial volume", VOLUME_MIN_gal, VOLUME_MAX_gal)
    drift_K_per_h: float = quantity(0.0, "K/h", "initial drift of the inflow", -100.0, 100.0)
    turn_s: float = quantity(3600.0, "s", "time after which this drift turns", 1.0, 1e7)
    sensor_s: float = quantity(0.0, "s", "time constant of the sensor; 0 for no lag", 0.0, 1e4)
    ageing_per_h: float = quantity(0.0, "1/h", "relative rise of the heater resistance", 0.0, 10.0)

    def __post_init__(self) -> None:
        check_quantities(self)


class Bath:
    """Heater and water behind the coupling.

    Attributes:
        output: Temperature above that of the inflow at the start, as the sensor shows it.
        water_K: Temperature above that, where the sensor lags.
        inflow_L_per_min: Cold water flowing in.
        inflow_K: Temperature of the inflow at the start.
        inflow_shift_K: Temperature of the inflow above that.
        heater_W: Mean power of the heater over the last step.
    """

    def __init__(self, parameters: BathParameters) -> None:
        self.parameters = parameters
        self.emf_V = 0.0
        self.resistance_Ohm = parameters.heater_Ohm
        self.output = 0.0
        self.water_K = 0.0
        self.inflow_K = INFLOW_K
        self.inflow_shift_K = 0.0
        self.heater_W = 0.0
        self._mass_kg = parameters.volume_gal * GALLON_kg
        self._target_kg = self._mass_kg
        self._filling_kg_s = 0.0
        self.inflow_L_per_min = parameters.inflow_L_per_min
        self._drift_K_per_s = parameters.drift_K_per_h / 3600.0
        self._turns_in_s = parameters.turn_s
        self._ageing_Ohm_per_s = parameters.heater_Ohm * parameters.ageing_per_h / 3600.0

    @property
    def volume_gal(self) -> float:
        """Return the present volume of the bath in US gallons."""
        return self._mass_kg / GALLON_kg

    def disturb(self, inflow: float) -> None:
        """Let a multiple of the inflow at the start flow in from now on."""
        self.inflow_L_per_min = inflow * self.parameters.inflow_L_per_min

    @property
    def _inflow_W_per_K(self) -> float:
        """Heat that the inflow takes."""
        return self.inflow_L_per_min / 60.0 * HEAT_J_per_kgK

    @property
    def resistance_K_per_W(self) -> float:
        """Thermal resistance to the inflow, R."""
        return 1.0 / self._inflow_W_per_K

    def fill(self, volume_gal: float, over_s: float = 0.0) -> None:
        """Move the drain level, so that the volume changes steadily from now on.

        Args:
            volume_gal: Volume at the end.
            over_s: How long it takes; 0 changes it at once, at constant temperature.
        """
        check_range("volume_gal", volume_gal, VOLUME_MIN_gal, VOLUME_MAX_gal, "US gal")
        check_range("over_s", over_s, 0.0, FILLING_MAX_s, "s")
        self._move_level(volume_gal * GALLON_kg, over_s)

    def resize(self, size: float, over_s: float) -> None:
        """Fill it steadily to a multiple of the volume at the start."""
        self._move_level(size * self.parameters.volume_gal * GALLON_kg, over_s)

    def _move_level(self, mass_kg: float, over_s: float) -> None:
        self._target_kg = mass_kg
        if over_s > 0.0:
            self._filling_kg_s = (self._target_kg - self._mass_kg) / over_s
        else:
            self._mass_kg, self._filling_kg_s = self._target_kg, 0.0

    def drive(self, source_V: float, source_Ohm: float, duration_s: float) -> float:
        """Advance while a constant voltage behind a resistance feeds the heater."""
        current_A = source_V / (source_Ohm + self.resistance_Ohm)
        self.heater_W = current_A * current_A * self.resistance_Ohm
        self._warm(duration_s)
        return current_A

    def coast(self, duration_s: float) -> None:
        """Advance with the heater off."""
        self.heater_W = 0.0
        self._warm(duration_s)

    def settle(self, source_V: float, source_Ohm: float) -> None:
        """Put the bath at rest under a constant source."""
        current_A = source_V / (source_Ohm + self.resistance_Ohm)
        self.heater_W = current_A * current_A * self.resistance_Ohm
        self.output = self.water_K = self.heater_W * self.resistance_K_per_W

    def source_for(self, output: float, source_Ohm: float) -> float:
        """Find the source voltage that holds a temperature above the inflow's."""
        heater_W = output / self.resistance_K_per_W
        return (source_Ohm + self.resistance_Ohm) * math.sqrt(heater_W / self.resistance_Ohm)

    def model(self, ratio: float, source_Ohm: float) -> dict[str, float]:
        """Thermal resistance, time constant, and heater power per squared boost volt."""
        per_Ohm = 1.0 / (source_Ohm + self.resistance_Ohm)
        return {
            "resistance_K_per_W": self.resistance_K_per_W,
            "tau_s": self._mass_kg * HEAT_J_per_kgK * self.resistance_K_per_W,
            "heater_W_per_V2": (ratio * per_Ohm) ** 2 * self.resistance_Ohm,
        }

    def state(self) -> dict[str, float]:
        """Volume, temperature above the inflow and heater power."""
        volume_gal = self.volume_gal
        return {"volume_gal": volume_gal, "temperature_K": self.output, "heater_W": self.heater_W}

    def _warm(self, duration_s: float) -> None:
        rest = self.heater_W * self.resistance_K_per_W + self.inflow_shift_K
        filling = self._filling_kg_s != 0.0
        decay = self._fill_step(duration_s) if filling else self._steady_decay(duration_s)
        if self.parameters.sensor_s > 0.0:
            self.water_K = rest + (self.water_K - rest) * decay
            lag = math.exp(-duration_s / self.parameters.sensor_s)
            self.output = self.water_K + (self.output - self.water_K) * lag
        else:
            self.output = rest + (self.output - rest) * decay
        if self._drift_K_per_s != 0.0 or self._ageing_Ohm_per_s != 0.0:
            self._grow_older(duration_s)

    def _grow_older(self, duration_s: float) -> None:
        """Let the inflow's temperature drift, and the heater age."""
        self.resistance_Ohm += self._ageing_Ohm_per_s * duration_s
        self.inflow_shift_K += self._drift_K_per_s * duration_s
        self._turns_in_s -= duration_s
        if self._turns_in_s <= 0.0:
            self._drift_K_per_s = -self._drift_K_per_s
            self._turns_in_s += self.parameters.turn_s

    def _steady_decay(self, duration_s: float) -> float:
        """Return the remaining fraction of a temperature excess after a time at constant volume."""
        return math.exp(-duration_s * self._inflow_W_per_K / (self._mass_kg * HEAT_J_per_kgK))

    def _fill_step(self, duration_s: float) -> float:
        """Move the level for one step; what is left of a temperature excess is returned."""
        rate, mass_kg = self._filling_kg_s, self._mass_kg
        left_s = (self._target_kg - mass_kg) / rate
        if left_s > duration_s:
            self._mass_kg = mass_kg + rate * duration_s
            rest_s = 0.0
        else:
            self._mass_kg, self._filling_kg_s = self._target_kg, 0.0
            rest_s = duration_s - left_s
        power = self._inflow_W_per_K / (rate * HEAT_J_per_kgK)
        return math.pow(mass_kg / self._mass_kg, power) * self._steady_decay(rest_s)
