"""A battery that is charged: open-circuit voltage, series resistance, relaxation, charge.

With the source V behind R_d and the state of charge z:

    i = (V − E(z) − v1 − v2)/(R_d + R_0),   C_j·dv_j/dt = i − v_j/R_j,   Q·dz/dt = i

E(z) is a cell's curve times the number of cells. The current is positive while it charges; only
a bidirectional drive can make it negative. One step takes the current as linear over it, which is
exact to the third power of the step over the relaxation times.
"""

import math
from dataclasses import dataclass

from adaptdrive_sim.parameters import check_quantities, check_range, quantity

# Open-circuit voltage of a lithium-ion cell, at every tenth of its charge.
CELL_V = (3.00, 3.43, 3.53, 3.59, 3.63, 3.68, 3.76, 3.86, 3.96, 4.07, 4.19)


@dataclass(frozen=True, slots=True)
class BatteryParameters:
    """Cells and what stands between them and the terminals.

    Attributes:
        cells: Cells in series.
        relaxation_2_Ohm: 0 leaves the second relaxation element out.
    """

    cells: int = 20
    capacity_Ah: float = quantity(10.0, "A h", "charge between empty and full, Q", 1e-3, 1e4)
    charge: float = quantity(0.3, "", "state of charge at the start, 0 to 1", 0.0, 1.0)
    series_Ohm: float = quantity(0.20, "Ω", "series resistance, R_0", 1e-4, 1e2)
    relaxation_Ohm: float = quantity(0.40, "Ω", "first relaxation element, R_1", 1e-4, 1e2)
    relaxation_s: float = quantity(30.0, "s", "its time constant, R_1·C_1", 0.5, 1e5)
    relaxation_2_Ohm: float = quantity(0.0, "Ω", "second relaxation element, R_2", 0.0, 1e2)
    relaxation_2_s: float = quantity(600.0, "s", "its time constant, R_2·C_2", 0.5, 1e5)

    def __post_init__(self) -> None:
        check_quantities(self)
        check_range("BatteryParameters.cells", self.cells, 1, 1000, "")


class Battery:
    """Cells, relaxation elements and charge.

    Attributes:
        resistance_Ohm: Series resistance, R_0.
        output: Charging current, mean over the last half line cycle.
        charge: State of charge, 0 to 1; beyond, the curve's end is extended.
        relaxed_V: Voltages of the relaxation elements.
    """

    def __init__(self, parameters: BatteryParameters, cell_V: tuple[float, ...] = CELL_V) -> None:
        """Fill a battery.

        Args:
            parameters: Cells, and what stands between them and the terminals.
            cell_V: Open-circuit voltage of a cell at equal steps of its charge, from empty to full.
        """
        self.parameters = parameters
        self.cell_V = cell_V
        self.cells = float(parameters.cells)
        self.resistance_Ohm = parameters.series_Ohm
        self.output = 0.0
        self.charge = parameters.charge
        self.relaxed_V = [0.0, 0.0]

    @property
    def open_circuit_V(self) -> float:
        """Terminal voltage after a long rest."""
        steps = len(self.cell_V) - 1
        segment = min(max(int(steps * self.charge), 0), steps - 1)
        low, high = self.cell_V[segment], self.cell_V[segment + 1]
        return self.cells * (low + (high - low) * (steps * self.charge - segment))

    @property
    def emf_V(self) -> float:
        """Terminal voltage without current, at this instant."""
        return self.open_circuit_V + self.relaxed_V[0] + self.relaxed_V[1]

    @property
    def terminal_voltage_V(self) -> float:
        """Terminal voltage under the present current."""
        return self.emf_V + self.resistance_Ohm * self.output

    def drive(self, source_V: float, source_Ohm: float, duration_s: float) -> float:
        """Advance while a constant voltage behind a resistance feeds the terminals."""
        per_Ohm = 1.0 / (source_Ohm + self.resistance_Ohm)
        charge, first_V, second_V = self.charge, self.relaxed_V[0], self.relaxed_V[1]
        first_A = (source_V - self.emf_V) * per_Ohm
        self._carry(first_A, duration_s)
        mean_A = 0.5 * (first_A + (source_V - self.emf_V) * per_Ohm)
        self.charge, self.relaxed_V[0], self.relaxed_V[1] = charge, first_V, second_V
        self._carry(mean_A, duration_s)
        self.output = mean_A
        return mean_A

    def resize(self, size: float, _over_s: float) -> None:
        """Let the series resistance be a multiple of that at the start from now on."""
        self.resistance_Ohm = size * self.parameters.series_Ohm

    def disturb(self, shorted: float) -> None:
        """Let a number of cells be shorted from now on."""
        self.cells = self.parameters.cells - shorted

    def coast(self, duration_s: float) -> None:
        """Advance without current: the relaxation elements discharge themselves."""
        self._carry(0.0, duration_s)
        self.output = 0.0

    def settle(self, source_V: float, source_Ohm: float) -> None:
        """Put the relaxation elements at rest under a constant source, at the present charge."""
        series_Ohm = source_Ohm + self.resistance_Ohm + sum(self._relaxation_Ohm())
        self.output = (source_V - self.open_circuit_V) / series_Ohm
        self.relaxed_V = [self.output * resistance for resistance in self._relaxation_Ohm()]

    def source_for(self, output: float, source_Ohm: float) -> float:
        """Find the source voltage that makes a current flow, once the elements have relaxed."""
        series_Ohm = source_Ohm + self.resistance_Ohm + sum(self._relaxation_Ohm())
        return self.open_circuit_V + output * series_Ohm

    def model(self, ratio: float, source_Ohm: float) -> dict[str, float]:
        """Admittance from boost voltage to current: at once, in the end, and the way between.

        The time constant is that of the area between the step response and its end, which is
        the only one there is with a single relaxation element.
        """
        own, first_Ohm = self.parameters, source_Ohm + self.resistance_Ohm
        relaxation_Ohm = sum(self._relaxation_Ohm())
        last_Ohm = first_Ohm + relaxation_Ohm
        stored = own.relaxation_Ohm * own.relaxation_s + own.relaxation_2_Ohm * own.relaxation_2_s
        return {
            "direct_S": ratio / first_Ohm,
            "gain_S": ratio / last_Ohm,
            "tau_s": stored / relaxation_Ohm * first_Ohm / last_Ohm,
        }

    def state(self) -> dict[str, float]:
        """State of charge, open-circuit and terminal voltage."""
        open_V, terminal_V = self.open_circuit_V, self.terminal_voltage_V
        return {"charge": self.charge, "open_circuit_V": open_V, "terminal_voltage_V": terminal_V}

    def _relaxation_Ohm(self) -> tuple[float, float]:
        return self.parameters.relaxation_Ohm, self.parameters.relaxation_2_Ohm

    def _carry(self, current_A: float, duration_s: float) -> None:
        """Let a constant current flow for a time."""
        own, relaxed = self.parameters, self.relaxed_V
        taus_s = own.relaxation_s, own.relaxation_2_s
        for i, resistance_Ohm in enumerate(self._relaxation_Ohm()):
            rest_V = current_A * resistance_Ohm
            relaxed[i] = rest_V + (relaxed[i] - rest_V) * math.exp(-duration_s / taus_s[i])
        self.charge += current_A * duration_s / (3600.0 * own.capacity_Ah)
