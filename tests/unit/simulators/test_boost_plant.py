"""The boost stage against an independent integrator, closed forms and known figures."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptdrive_sim.plants.boost import Boost, BoostParameters

HALF_CYCLE_s = 1.0 / 120.0
LINE_V = 120.0
CAPACITANCE_F = 1.0e-3
PEAK_V = LINE_V * math.sqrt(2.0)


def boost(voltage_V: float, *, bidirectional: bool = False) -> Boost:
    own = BoostParameters(capacitance_F=CAPACITANCE_F, bidirectional=bidirectional)
    return Boost(own, voltage_V)


def constant_power(stage: Boost, current_scale_S: float, load_W: float) -> float:
    """One half cycle with a load that draws (nearly) constant power."""
    offset_A = -load_W / stage.voltage_V
    return stage.advance(current_scale_S, LINE_V, (0.0, offset_A), HALF_CYCLE_s)


@given(
    voltage_V=st.floats(250.0, 400.0),
    current_scale_S=st.floats(0.0, 0.15),
    conductance_S=st.floats(0.0, 0.02),
    emf_V=st.floats(0.0, 50.0),
)
def test_one_half_cycle_agrees_with_an_independent_integrator(
    voltage_V: float, current_scale_S: float, conductance_S: float, emf_V: float
) -> None:
    offset_A = emf_V * conductance_S / 0.25

    def slope(_: float, state: list[float]) -> list[float]:
        v = math.sqrt(state[0])
        load_W = v * max(0.0, conductance_S * v - offset_A)
        return [2.0 / CAPACITANCE_F * (current_scale_S * LINE_V**2 - load_W), v, load_W]

    start = [voltage_V**2, 0.0, 0.0]
    true = solve_ivp(slope, (0.0, HALF_CYCLE_s), start, rtol=1e-10, atol=1e-9).y[:, -1]
    stage = boost(voltage_V)
    end_V = stage.advance(current_scale_S, LINE_V, (conductance_S, offset_A), HALF_CYCLE_s)
    # within what a frame of the drive resolves: 0.01 V and some 0.1 W
    assert end_V == pytest.approx(math.sqrt(true[0]), abs=0.01)
    assert stage.mean_voltage_V == pytest.approx(true[1] / HALF_CYCLE_s, abs=0.01)
    assert stage.mean_load_W == pytest.approx(true[2] / HALF_CYCLE_s, abs=0.5)


def test_without_a_load_the_squared_voltage_is_linear_in_the_command() -> None:
    stage = boost(300.0)
    for _ in range(10):
        stage.advance(0.02, LINE_V, (0.0, 0.0), HALF_CYCLE_s)
    gained = 10 * 2.0 * HALF_CYCLE_s * LINE_V**2 / CAPACITANCE_F * 0.02
    assert stage.squared_V2 == pytest.approx(300.0**2 + gained, rel=1e-12)


@pytest.mark.parametrize(("start_V", "first_dip_V", "second_dip_V"), [(300, 14, 29), (350, 12, 25)])
def test_a_500_W_step_dips_by_the_known_figures(
    start_V: float, first_dip_V: float, second_dip_V: float
) -> None:
    stage = boost(start_V)
    assert start_V - constant_power(stage, 0.0, 500.0) == pytest.approx(first_dip_V, abs=0.6)
    assert start_V - constant_power(stage, 0.0, 500.0) == pytest.approx(second_dip_V, abs=0.8)


def test_without_command_or_load_the_capacitor_charges_to_the_peak_of_the_line() -> None:
    stage = boost(0.0)
    for _ in range(120):
        stage.advance(0.0, LINE_V, (0.0, 0.0), HALF_CYCLE_s)
    assert stage.voltage_V == pytest.approx(PEAK_V, abs=0.1)
