"""The motor plant against an independent integrator and closed forms."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from adaptdrive_sim.parameters import ParameterError
from adaptdrive_sim.plants.motor import Motor, MotorParameters

DROOP_Ohm = 1.0


def integrate(
    own: MotorParameters, disks: int, torque_Nm: float, source_V: float, span_s: float
) -> tuple[float, float, float]:
    """The same motor from its differential equations; returns speed, output, mean current."""

    def slope(_: float, state: list[float]) -> list[float]:
        speed, output, _charge = state
        current = (source_V - own.constant_Vs * speed) / (DROOP_Ohm + own.resistance_Ohm)
        brake = torque_Nm + own.coulomb_Nm + own.drag_Nms2 * speed**2
        drive = own.constant_Vs * current - own.friction_Nms * speed - brake
        return [
            drive / (own.disk_kgm2 * disks),
            (own.tachometer_Vs * speed - output) / own.filter_s,
            current,
        ]

    start = [30.0, 0.2, 0.0]
    last = solve_ivp(slope, (0.0, span_s), start, rtol=1e-11, atol=1e-12).y[:, -1]
    return float(last[0]), float(last[1]), float(last[2]) / span_s


@given(
    disks=st.integers(1, 4),
    torque_Nm=st.floats(0.0, 2.0),
    source_V=st.floats(40.0, 100.0),
    filter_s=st.sampled_from([0.5, 5.0, 10.0, 11.7, 11.70001, 23.4]),
)
def test_one_long_step_is_exact(
    disks: int, torque_Nm: float, source_V: float, filter_s: float
) -> None:
    own = MotorParameters(filter_s=filter_s)
    motor = Motor(own, disks)
    motor.speed_rad_s, motor.output, motor.torque_Nm = 30.0, 0.2, torque_Nm
    current = motor.drive(source_V, DROOP_Ohm, 3.0)
    expected = integrate(own, disks, torque_Nm, source_V, 3.0)
    assert (motor.speed_rad_s, motor.output, current) == pytest.approx(expected, rel=1e-8)


def test_dry_friction_and_drag_brake_as_their_equation_says() -> None:
    own = MotorParameters(coulomb_Nm=0.3, drag_Nms2=2e-5)
    motor = Motor(own)
    motor.speed_rad_s, motor.output = 30.0, 0.2
    for _ in range(1200):
        motor.drive(70.0, DROOP_Ohm, 1.0 / 120.0)
    speed, output, _ = integrate(own, 1, 0.0, 70.0, 10.0)
    assert (motor.speed_rad_s, motor.output) == pytest.approx((speed, output), rel=5e-5)


def test_the_gain_under_drag_is_that_of_small_movements() -> None:
    motor = Motor(MotorParameters(coulomb_Nm=0.3, drag_Nms2=2e-5))
    motor.settle(70.0, DROOP_Ohm)
    outputs = []
    for source_V in (69.9, 70.1):
        motor.settle(source_V, DROOP_Ohm)
        outputs.append(motor.output)
    slope = 0.25 * (outputs[1] - outputs[0]) / 0.2
    assert motor.model(0.25, DROOP_Ohm)["gain"] == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("disks", [1, 2, 3])
def test_reference_motor_has_the_published_model(disks: int) -> None:
    model = Motor(MotorParameters(), disks).model(0.25, DROOP_Ohm)
    assert model["gain"] == pytest.approx(0.0110, rel=1e-3)
    assert model["tau_motor_s"] == pytest.approx(11.70 * disks, rel=1e-3)
    assert model["tau_filter_s"] == 10.0


@given(output=st.floats(0.5, 4.0), torque_Nm=st.floats(0.0, 2.0))
def test_source_for_an_output_settles_on_that_output(output: float, torque_Nm: float) -> None:
    motor = Motor(MotorParameters())
    motor.torque_Nm = torque_Nm
    motor.settle(motor.source_for(output, DROOP_Ohm), DROOP_Ohm)
    assert motor.output == pytest.approx(output, rel=1e-12)


def test_coasting_leaves_friction_alone() -> None:
    motor = Motor(MotorParameters())
    motor.speed_rad_s = 100.0
    motor.coast(5.0)
    assert motor.speed_rad_s == pytest.approx(100.0 * math.exp(-5.0 * 0.0125 / 0.4095), rel=1e-12)


def test_a_brake_stops_the_shaft_and_does_not_turn_it_back() -> None:
    motor = Motor(MotorParameters())
    motor.speed_rad_s, motor.torque_Nm = 1.0, 5.0
    for _ in range(1200):
        motor.coast(1.0 / 120.0)
    assert motor.speed_rad_s == 0.0


def test_a_disk_dropped_at_rest_shares_the_angular_momentum_and_another_keeps_the_speed() -> None:
    usual = Motor(MotorParameters())
    usual.speed_rad_s = 120.0
    usual.disks = 2
    assert (usual.speed_rad_s, usual.inertia_kgm2) == pytest.approx((120.0, 0.819))
    motor = Motor(MotorParameters(dropped_at_rest=True))
    motor.speed_rad_s = 120.0
    momentum = motor.speed_rad_s * motor.inertia_kgm2
    motor.disks = 3
    assert motor.speed_rad_s * motor.inertia_kgm2 == pytest.approx(momentum)
    motor.disks = 1
    assert motor.speed_rad_s == pytest.approx(40.0)


@pytest.mark.parametrize("value", [0.0, math.nan])
def test_a_parameter_out_of_range_is_refused_by_name(value: float) -> None:
    with pytest.raises(ParameterError, match=r"MotorParameters\.disk_kgm2 = .* must lie in"):
        MotorParameters(disk_kgm2=value)
