"""The voltage loop inside a drive that holds its own boost voltage."""

from __future__ import annotations

from adaptdrive.control import voltage_loop
from adaptdrive_sim.world import Sample

SCALE_MAX_S = 0.15
LOWEST_LINE_V = 1.0


class VoltageHolder:
    """Makes v_bst follow V_c by the line current, half cycle by half cycle."""

    def __init__(self, capacitance_F: float, *, bidirectional: bool) -> None:
        self._capacitance_F = capacitance_F
        self._lowest_S = -SCALE_MAX_S if bidirectional else 0.0
        self._sum: float | None = None

    def scale_S(self, reference_V: float, sample: Sample) -> float:
        """The line-current scale k for the coming half cycle; 0 while no voltage is asked for."""
        if reference_V <= 0.0:
            self._sum = None
            return 0.0
        voltage_V = sample.boost_voltage_V
        if self._sum is None:
            self._sum = voltage_loop.initial_sum(voltage_V)
        wanted_S = voltage_loop.current_scale(
            self._sum,
            voltage_V,
            sample.load_power_W,
            max(sample.line_voltage_V, LOWEST_LINE_V),
            sample.tick_period_s,
            self._capacitance_F,
        )
        scale_S = min(max(wanted_S, self._lowest_S), SCALE_MAX_S)
        limit = (wanted_S > scale_S) - (wanted_S < scale_S)
        self._sum = voltage_loop.advance_sum(self._sum, reference_V, voltage_V, limit)
        return scale_S
