"""Mode manual in virtual time: V_c from the operator, and the transfers between the modes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.runtime.requests import SetMode, SetSetpoint, SetVoltage
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, SimulatedLoad, World
from tests.integration.closed_loop.bench import TICK_s
from tests.integration.closed_loop.life import started, wait
from tests.support import sample


def settled(name: str, load: SimulatedLoad, output: float, noise: float = 0.0) -> OperatedDrive:
    """A drive at rest at an output under the fixed controller."""
    plant = World(load, noise=NoiseParameters(sigma=noise))
    plant.settle(plant.boost_voltage_for(output))
    drive = started(name, plant)
    drive.carry_out(SetSetpoint(output))
    wait(drive, 30.0)
    return drive


def motor(noise: float = 0.0) -> OperatedDrive:
    return settled("motor", Motor(MotorParameters()), 3.0, noise)


def bath() -> OperatedDrive:
    return settled("bath", Bath(BathParameters()), 10.0)


def battery() -> OperatedDrive:
    return settled("battery", Battery(BatteryParameters()), 5.0)


def in_force_V(drive: OperatedDrive) -> float:
    return drive._command.boost_reference_V


def courses(drive: OperatedDrive, seconds: float) -> tuple[list[float], list[float]]:
    """V_c and output of each tick for a while."""
    voltages, outputs, end_s = [], [], drive.time_s + seconds
    while drive.time_s < end_s:
        drive.tick()
        voltages.append(in_force_V(drive))
        outputs.append(drive.world.true_output)
    return voltages, outputs


@pytest.mark.parametrize("started_drive", [motor, bath, battery])
def test_manual_holds_the_present_voltage(started_drive: Callable[[], OperatedDrive]) -> None:
    drive = started_drive()
    present_V = in_force_V(drive)
    drive.carry_out(SetMode(Mode.MANUAL))
    voltages, _ = courses(drive, 20.0)
    assert set(voltages) == {present_V}
    assert drive.decision is not None
    assert drive.decision.controller is Mode.MANUAL


def test_a_voltage_never_charges_a_battery_above_its_limit() -> None:
    load = Battery(BatteryParameters(charge=0.85))
    drive = settled("battery", load, 2.0)
    drive.carry_out(SetMode(Mode.MANUAL))
    drive.carry_out(SetVoltage(380.0))
    terminals_V = []
    for _ in range(round(120.0 / TICK_s)):
        drive.tick()
        terminals_V.append(load.terminal_voltage_V)
    assert max(terminals_V) < 82.0 * 1.001
    assert terminals_V[-1] == pytest.approx(82.0, rel=1e-3)


@pytest.mark.parametrize("mode", sample([Mode.ADAPTIVE, Mode.FIXED], 1))
@pytest.mark.parametrize(
    ("started_drive", "step_V", "wait_s", "limit_V"),
    sample([(motor, 30.0, 200.0, 1.0), (battery, 2.0, 30.0, 0.5), (bath, 20.0, 1200.0, 1.0)], 2),
)
def test_the_transfer_from_manual_has_no_bump(
    started_drive: Callable[[], OperatedDrive],
    step_V: float,
    wait_s: float,
    limit_V: float,
    mode: Mode,
) -> None:
    drive = started_drive()
    drive.carry_out(SetMode(Mode.MANUAL))
    drive.carry_out(SetVoltage(in_force_V(drive) + step_V))
    wait(drive, wait_s)
    present_V, present = in_force_V(drive), drive.world.true_output
    drive.carry_out(SetMode(mode))
    assert drive.machine.asked.setpoint == pytest.approx(present, rel=1e-3)
    voltages, outputs = courses(drive, wait_s)
    assert max(abs(voltage - present_V) for voltage in voltages) < limit_V
    assert max(abs(output - present) for output in outputs) < 0.01 * present


def test_the_estimator_learns_from_the_steps_of_the_operator() -> None:
    drive = motor(noise=0.01)
    drive.carry_out(SetMode(Mode.MANUAL))
    for _ in range(3):
        for voltage_V in (300.0, 260.0):
            drive.carry_out(SetVoltage(voltage_V))
            wait(drive, 30.0)
    assert drive.decision is not None
    true_value = 0.011
    gain = drive.decision.estimates["gain"]
    assert gain.value == pytest.approx(true_value, rel=0.03)
    drive.carry_out(SetMode(Mode.ADAPTIVE))
    wait(drive, 5.0)
    assert drive.decision.controller is Mode.ADAPTIVE
