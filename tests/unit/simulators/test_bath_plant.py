"""The bath plant against an independent integrator and closed forms."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptdrive_sim.plants.bath import Bath, BathParameters, GALLON_kg, HEAT_J_per_kgK

DROOP_Ohm = 1.0
INFLOW_kg_s = 0.681 / 60.0


def integrate_mixing(start_gal: float, end_gal: float, over_s: float, span_s: float) -> float:
    """Temperature from the balances of mass and heat, with the outflow written out."""
    heater_W = 7.87 * (75.0 / 8.87) ** 2

    def slope(time_s: float, state: list[float]) -> list[float]:
        mass_kg, heat_J = state
        growth = (end_gal - start_gal) * GALLON_kg / over_s if time_s < over_s else 0.0
        outflow_kg_s = INFLOW_kg_s - growth
        return [growth, heater_W - outflow_kg_s * heat_J / mass_kg]

    mass_kg = start_gal * GALLON_kg
    start = [mass_kg, mass_kg * HEAT_J_per_kgK * 5.0]
    last = solve_ivp(slope, (0.0, span_s), start, rtol=1e-11, atol=1e-9, max_step=5.0).y[:, -1]
    return float(last[1] / (last[0] * HEAT_J_per_kgK))


@pytest.mark.parametrize(("start_gal", "end_gal"), [(0.6, 1.5), (1.5, 0.6), (0.6, 0.61)])
def test_while_the_level_moves_the_bath_obeys_the_balances_of_mass_and_heat(
    start_gal: float, end_gal: float
) -> None:
    bath = Bath(BathParameters(volume_gal=start_gal))
    bath.output = 5.0
    bath.fill(end_gal, 300.0)
    for _ in range(400):
        bath.drive(75.0, DROOP_Ohm, 1.0)
    expected = integrate_mixing(start_gal, end_gal, 300.0, 400.0)
    assert bath.output == pytest.approx(expected, rel=1e-6)
    assert bath.volume_gal == pytest.approx(end_gal, rel=1e-12)


@pytest.mark.parametrize(("volume_gal", "tau_s"), [(0.6, 200.0), (1.5, 500.0)])
def test_the_reference_bath_has_its_published_model(volume_gal: float, tau_s: float) -> None:
    model = Bath(BathParameters(volume_gal=volume_gal)).model(0.25, DROOP_Ohm)
    assert model["resistance_K_per_W"] == pytest.approx(0.02104, rel=1e-3)
    assert model["tau_s"] == pytest.approx(tau_s, rel=2e-3)


def test_without_heat_the_bath_cools_towards_the_inflow() -> None:
    bath = Bath(BathParameters())
    bath.output = 8.0
    bath.coast(100.0)
    tau_s = bath.model(0.25, DROOP_Ohm)["tau_s"]
    assert bath.output == pytest.approx(8.0 * math.exp(-100.0 / tau_s), rel=1e-12)
    assert bath.heater_W == 0.0


@given(output=st.floats(6.0, 20.0))
def test_source_for_an_output_settles_on_that_output(output: float) -> None:
    bath = Bath(BathParameters())
    bath.settle(bath.source_for(output, DROOP_Ohm), DROOP_Ohm)
    assert bath.output == pytest.approx(output, rel=1e-12)
    for _ in range(10):
        bath.drive(bath.source_for(output, DROOP_Ohm), DROOP_Ohm, 60.0)
    assert bath.output == pytest.approx(output, rel=1e-12)


def test_with_an_inflow_that_drifts_the_bath_obeys_the_balance_of_heat() -> None:
    """In absolute temperatures, with the drift written out: 2 K/h, turning after 600 s."""
    drift_K_s, inflow_W_K = 2.0 / 3600.0, INFLOW_kg_s * HEAT_J_per_kgK
    heater_W = 7.87 * (75.0 / 8.87) ** 2

    def slope(time_s: float, state: list[float]) -> list[float]:
        inflow_K = 290.0 + drift_K_s * abs((time_s + 600.0) % 1200.0 - 600.0)
        supply_W = heater_W - inflow_W_K * (state[0] - inflow_K)
        return [supply_W / (0.6 * GALLON_kg * HEAT_J_per_kgK)]

    last = solve_ivp(slope, (0.0, 1500.0), [295.0], rtol=1e-10, atol=1e-9, max_step=5.0).y[0, -1]
    bath = Bath(BathParameters(drift_K_per_h=2.0, turn_s=600.0))
    bath.output = 5.0
    for _ in range(15_000):
        bath.drive(75.0, DROOP_Ohm, 0.1)
    assert bath.output == pytest.approx(float(last) - 290.0, abs=1e-3)
    assert bath.inflow_shift_K == pytest.approx(300.0 * drift_K_s, abs=1e-4)
