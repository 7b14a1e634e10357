"""The shape that every simulated load shares.

Seen from the secondary of the dc/dc stage a load is an electromotive force behind a resistance;
what happens behind them (a turning shaft, warming water, a filling battery) is its own affair.
The boost stage needs only those two numbers, and the load needs only the source that feeds it.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Sample(NamedTuple):
    """Measurements of the drive at the end of a half cycle.

    Attributes:
        tick: Half cycles since the start.
        tick_period_s: Length of the elapsed half cycle.
        boost_voltage_V: v_bst at the sampling phase, ripple included.
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


class SimulatedLoad(Protocol):
    """One simulated load, stepped by whole half line cycles."""

    @property
    def emf_V(self) -> float:
        """Terminal voltage without current, at this instant."""

    @property
    def resistance_Ohm(self) -> float:
        """Series resistance between the terminals and the electromotive force."""

    @property
    def output(self) -> float:
        """The regulated quantity without measurement noise, in its own unit."""

    def drive(self, source_V: float, source_Ohm: float, duration_s: float) -> float:
        """Advance while a constant voltage behind a resistance feeds the load.

        Returns:
            Mean current from the source, in ampere.
        """

    def coast(self, duration_s: float) -> None:
        """Advance without any current."""

    def settle(self, source_V: float, source_Ohm: float) -> None:
        """Put the load at rest under a constant source, filters included."""

    def source_for(self, output: float, source_Ohm: float) -> float:
        """Find the source voltage at which the load rests with the given output."""

    def model(self, ratio: float, source_Ohm: float) -> dict[str, float]:
        """Parameters of the linear model from boost voltage to output, by name.

        Args:
            ratio: Load-side volts per volt of boost voltage.
            source_Ohm: Resistance of the source that feeds the load.
        """

    def state(self) -> dict[str, float]:
        """Return the internal state, by name with unit."""
