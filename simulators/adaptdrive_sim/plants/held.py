"""The output of a drive that holds it itself: a voltage, a frequency or a torque without a floor.

It follows its reference with a first-order lag, whatever the load draws and the line gives.
"""

from __future__ import annotations

import math

from adaptdrive_sim.plants.boost import Boost, BoostParameters
from adaptdrive_sim.plants.load import Sample


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
        self,
        current_scale_S: float,
        line_V: float,
        conductance_S: float,
        offset_A: float,
        duration_s: float,
    ) -> float:
        """Run one half line cycle, as the boost stage does."""
        del current_scale_S, line_V
        share = -math.expm1(-duration_s / self._lag_s) if self._lag_s else 1.0
        end_V = self.voltage_V + share * (self.reference_V - self.voltage_V)
        mean_V = 0.5 * (self.voltage_V + end_V)
        self.settle(end_V, mean_V * max(self._lowest, conductance_S * mean_V - offset_A))
        self.mean_voltage_V = mean_V
        return end_V
