"""The inductively coupled dc/dc stage: an ideal transformer with a droop resistance.

From the load's side it is a source N2·v behind R_d. From the boost capacitor's side it draws the
current N2·i, where i is the load current; with a load of electromotive force E and resistance R
that is i_boost(v) = G·v − H with G = N2²/(R_d + R) and H = N2·E/(R_d + R).
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive_sim.parameters import check_quantities, quantity


@dataclass(frozen=True, slots=True)
class CouplingParameters:
    """The dc/dc stage."""

    ratio: float = quantity(0.25, "", "secondary volts per volt of v_bst, N2", 0.01, 10.0)
    droop_Ohm: float = quantity(1.0, "Ω", "output resistance of the stage, R_d", 0.0, 100.0)

    def __post_init__(self) -> None:
        check_quantities(self)


class Coupling:
    """The stage as the boost capacitor and the load see it."""

    def __init__(self, parameters: CouplingParameters) -> None:
        self.parameters = parameters
        self.ratio = parameters.ratio
        self.droop_Ohm = parameters.droop_Ohm

    def draw(self, emf_V: float, resistance_Ohm: float) -> tuple[float, float]:
        """Return the load as seen from the boost capacitor.

        Returns:
            Conductance G in siemens and offset current H in ampere: i_boost(v) = G·v − H.
        """
        primary_S = self.ratio / (self.droop_Ohm + resistance_Ohm)
        return primary_S * self.ratio, primary_S * emf_V
