"""The battery plant against an independent integrator and closed forms; both kinds of drive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import lti, step

from adaptdrive.control.loads.battery import battery_load, physical
from adaptdrive_sim.plants.battery import CELL_V, Battery, BatteryParameters
from adaptdrive_sim.plants.boost import BoostParameters
from adaptdrive_sim.world import World

DROOP_Ohm = 1.0
TWO_ELEMENTS = BatteryParameters(
    relaxation_2_Ohm=0.15, relaxation_2_s=5.0, capacity_Ah=0.5, charge=0.35
)


def integrate(own: BatteryParameters, source_V: float, span_s: float) -> tuple[float, ...]:
    """The same battery from its differential equations: charge, v1, v2, mean current."""

    def slope(_: float, state: list[float]) -> list[float]:
        charge, one_V, two_V = state[:3]
        open_V = own.cells * float(np.interp(charge, np.linspace(0.0, 1.0, 11), CELL_V))
        current = (source_V - open_V - one_V - two_V) / (DROOP_Ohm + own.series_Ohm)
        return [
            current / (3600.0 * own.capacity_Ah),
            (own.relaxation_Ohm * current - one_V) / own.relaxation_s,
            (own.relaxation_2_Ohm * current - two_V) / own.relaxation_2_s,
            current,
        ]

    start = [own.charge, 0.0, 0.0, 0.0]
    last = solve_ivp(slope, (0.0, span_s), start, rtol=1e-10, atol=1e-12, max_step=0.1).y[:, -1]
    return (*map(float, last[:3]), float(last[3]) / span_s)


@pytest.mark.parametrize("own", [BatteryParameters(), TWO_ELEMENTS])
@pytest.mark.parametrize("source_V", [68.0, 90.0])
def test_charging_agrees_with_an_independent_integrator(
    own: BatteryParameters, source_V: float
) -> None:
    battery = Battery(own)
    mean_A = sum(battery.drive(source_V, DROOP_Ohm, 1.0 / 120.0) for _ in range(3600)) / 3600.0
    found = (battery.charge, *battery.relaxed_V, mean_A)
    assert found == pytest.approx(integrate(own, source_V, 30.0), rel=1e-6)


def test_the_model_is_the_admittance_of_the_control_side() -> None:
    own = BatteryParameters()
    load = battery_load(0.25, DROOP_Ohm + own.series_Ohm, own.relaxation_Ohm, own.relaxation_s)
    expected = dict(
        zip(load.names, physical(list(load.numerator), list(load.denominator)), strict=True)
    )
    assert Battery(own).model(0.25, DROOP_Ohm) == pytest.approx(expected, rel=1e-12)


def test_with_two_elements_the_model_keeps_the_area_under_the_step_response() -> None:
    own, model = TWO_ELEMENTS, Battery(TWO_ELEMENTS).model(1.0, DROOP_Ohm)
    one = np.poly1d([own.relaxation_s, 1.0])
    two = np.poly1d([own.relaxation_2_s, 1.0])
    impedance = 1.2 * one * two + own.relaxation_Ohm * two + own.relaxation_2_Ohm * one
    times, response = step(lti((one * two).coef, impedance.coef), T=np.linspace(0, 400, 200_001))
    area = float(np.trapezoid(response - response[-1], times))
    assert model["direct_S"] == pytest.approx(response[0], rel=1e-6)
    assert model["gain_S"] == pytest.approx(response[-1], rel=1e-6)
    assert model["tau_s"] == pytest.approx(area / (response[0] - response[-1]), rel=1e-4)


@given(output=st.floats(0.5, 10.0))
def test_source_for_a_current_lets_that_current_flow(output: float) -> None:
    battery = Battery(TWO_ELEMENTS)
    source_V = battery.source_for(output, DROOP_Ohm)
    battery.settle(source_V, DROOP_Ohm)
    assert battery.output == pytest.approx(output, rel=1e-9)
    assert battery.drive(source_V, DROOP_Ohm, 1e-6) == pytest.approx(output, rel=1e-6)
    assert battery.terminal_voltage_V == pytest.approx(source_V - output * DROOP_Ohm, rel=1e-6)


def brake(*, bidirectional: bool) -> tuple[World, list[float]]:
    """Draw line current backwards until the boost voltage is below that of the battery."""
    boost = BoostParameters(bidirectional=bidirectional)
    world = World(Battery(BatteryParameters(charge=0.8)), boost=boost)
    world.settle(world.boost_voltage_for(0.5))
    currents = []
    for _ in range(120):
        scale_S = -0.02 if world.boost.voltage_V > 250.0 else 0.0
        currents.append(world.step(scale_S, bridge=True).load_current_A)
    return world, currents


def test_a_two_way_drive_discharges_the_battery_into_the_line() -> None:
    world, currents = brake(bidirectional=True)
    assert world.load.state()["charge"] < 0.8
    assert currents[-1] < -1.0
    line_J = load_J = 0.0
    stored = world.boost.squared_V2
    for _ in range(1200):
        sample = world.step(-0.01, bridge=True)
        line_J += world.boost.mean_line_W * sample.tick_period_s
        load_J += sample.load_power_W * sample.tick_period_s
        assert sample.load_current_A < 0.0
    stored_J = 0.5e-3 * (world.boost.squared_V2 - stored)
    assert line_J == pytest.approx(-0.01 * 120.0**2 * 10.0, rel=2e-3)
    assert line_J == pytest.approx(load_J + stored_J, rel=1e-9)


def test_a_one_way_drive_cannot_discharge_the_battery() -> None:
    world, currents = brake(bidirectional=False)
    for _ in range(1200):
        currents.append(world.step(-0.01, bridge=True).load_current_A)
        assert world.boost.mean_line_W >= 0.0
    assert min(currents) >= 0.0
    assert world.load.state()["charge"] >= 0.8
