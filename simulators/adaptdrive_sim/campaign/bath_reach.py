"""Temperatures that V_c can hold."""

from __future__ import annotations

from collections.abc import Iterable

from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.coupling import CouplingParameters

NOMINAL_REACH_K = (5.5, 20.0)
"""Least and largest set-point of the example: 200 and 400 V hold 5.3 and 21 K."""

_BOOST_V = (200.0, 400.0)

_EDGE = 0.05
"""Least distance from what V_c holds to a set-point, as a share: noise needs some room."""


def bath_reach(
    inflows: Iterable[float], resistances: Iterable[float], shift_K: float
) -> tuple[float, float]:
    """Return the least and the largest set-point, by the drawn bath and by the model.

    Args:
        inflows: Flows of the run, relative to the model's.
        resistances: Of the heater in the run, likewise.
        shift_K: How far inflow and sensor may shift the temperature, up or down.
    """
    baths = [held_K(inflow, one) for inflow in inflows for one in resistances]
    least = (1.0 + _EDGE) * max(low for low, _ in baths) + shift_K
    most = (1.0 - _EDGE) * min(high for _, high in baths) - shift_K
    return max(least, NOMINAL_REACH_K[0]), min(most, NOMINAL_REACH_K[1])


def held_K(inflow: float, resistance: float) -> tuple[float, float]:
    """Return the temperatures at which a bath rests at the lowest and at the highest V_c."""
    bath, stage = Bath(bath_parameters(1.0, inflow, resistance)), CouplingParameters()
    model = bath.model(stage.ratio, stage.droop_Ohm)
    per_V2 = model["resistance_K_per_W"] * model["heater_W_per_V2"]
    return per_V2 * _BOOST_V[0] ** 2, per_V2 * _BOOST_V[1] ** 2


def bath_parameters(volume: float, inflow: float, resistance: float) -> BathParameters:
    """Return the reference bath with everything relative to it.

    Args:
        volume: At the start.
        inflow: At the start.
        resistance: Of the heater at the start.
    """
    nominal = BathParameters()
    return BathParameters(
        heater_Ohm=nominal.heater_Ohm * resistance,
        inflow_L_per_min=nominal.inflow_L_per_min * inflow,
        volume_gal=nominal.volume_gal * volume,
    )
