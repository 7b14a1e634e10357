"""A plant of the user in closed loop, against the simulators' own virtual drive."""

from __future__ import annotations

import math
import tomllib

import pytest

from adaptdrive.analysis.closed_loop import PlantLoop
from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import Command
from adaptdrive.lab import commission, simulate
from adaptdrive.util.errors import CommissionError, IdentificationError
from adaptdrive_sim.device import DeviceSettings, build_drive
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.support import sample
from tests.unit.described.described import DEVICES, NAMES
from tests.unit.devices.bench import EXAMPLES


class ReferenceMotor:
    """The simulators' motor behind an ideal dc/dc stage."""

    def __init__(self, disks: int) -> None:
        self.motor = Motor(MotorParameters(), disks)

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        current_A = self.motor.drive(0.25 * boost_voltage_V, 1.0, duration_s)
        return self.motor.output, max(0.0, 0.25 * current_A * boost_voltage_V)


class Broken:
    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        return math.nan, 0.0 * boost_voltage_V * duration_s


def square(time_s: float) -> float:
    return 3.2 if time_s % 120.0 < 60.0 else 3.0


def test_the_controller_learns_the_plant_it_is_given() -> None:
    plant = ReferenceMotor(3)
    true = plant.motor.model(0.25, 1.0)
    run = simulate(EXAMPLES / "motor.toml", plant, square, 300.0)
    last = run.slow.tail(1).to_dicts()[0]
    assert last["controller"] == "adaptive"
    assert last["estimate_gain"] == pytest.approx(true["gain"], rel=0.02)
    total_s = true["tau_motor_s"] + true["tau_filter_s"]
    assert last["estimate_tau_sum_s"] == pytest.approx(total_s, rel=0.02)
    assert run.fault == ""


def test_a_plant_that_returns_no_number_is_named() -> None:
    with pytest.raises(IdentificationError, match=r"the plant returned output nan .* at 0 s"):
        simulate(EXAMPLES / "motor.toml", Broken(), 3.0, 1.0)


class AtOwnStep(ReferenceMotor):
    """The motor as a program that takes steps of one length only."""

    def __init__(self, disks: int, step_s: float) -> None:
        super().__init__(disks)
        self.step_s = step_s
        self.time_s = 0.0

    def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
        assert duration_s == self.step_s
        self.time_s += duration_s
        return super().step(boost_voltage_V, duration_s)


@pytest.mark.parametrize(("step_s", "close"), sample([(0.25, 0.02), (1e-3, 0.02), (1.0, 0.06)], 1))
def test_a_plant_answers_at_its_own_step(step_s: float, close: float) -> None:
    """What is held for a whole slow period costs accuracy."""
    plant = AtOwnStep(2, step_s)
    true = plant.motor.model(0.25, 1.0)
    run = simulate(EXAMPLES / "motor.toml", plant, square, 300.0)
    assert plant.time_s == pytest.approx(300.0, abs=1.01 * step_s + 0.01)
    last = run.slow.tail(1).to_dicts()[0]
    assert last["estimate_gain"] == pytest.approx(true["gain"], rel=close)
    assert run.fault == ""


@pytest.mark.parametrize("step_s", [0.0, math.nan])
def test_a_step_that_is_no_time_is_named(step_s: float) -> None:
    with pytest.raises(IdentificationError, match=r"step_s of the plant is .*above 0 s"):
        simulate(EXAMPLES / "motor.toml", AtOwnStep(1, step_s), 3.0, 1.0)


def packaged(name: str) -> Configuration:
    file = DEVICES / f"{name}.toml"
    return validate_configuration(tomllib.loads(file.read_text(encoding="utf-8")), file)


class Belt:
    """A lag of six seconds, 3.14 rad/s per Hz, behind a frequency inverter."""

    speed = 0.0

    def step(self, frequency_Hz: float, duration_s: float) -> tuple[float, float]:
        self.speed -= math.expm1(-duration_s / 6.0) * (3.14 * frequency_Hz - self.speed)
        return self.speed, 0.0


def test_an_inverter_gives_the_few_hertz_that_it_is_asked_for() -> None:
    file = DEVICES / "siemens-v20.toml"
    last = simulate(file, Belt(), 60.0, 90.0).slow.tail(1).to_dicts()[0]
    assert last["output"] == pytest.approx(60.0, rel=0.01)
    assert last["boost_reference_V"] == pytest.approx(60.0 / 3.14, rel=0.01)


@pytest.mark.proof
def test_an_inverter_of_few_hertz_is_commissioned() -> None:
    found = commission(DEVICES / "siemens-v20.toml", Belt(), patience_s=20.0)
    assert found.prediction.quality.overshoot < 0.01
    assert found.refusal == ""


OWN_LOOPS = [name for name in NAMES if packaged(name).voltage_loop.where == "drive"]


@pytest.mark.parametrize("name", OWN_LOOPS)
def test_a_drive_with_its_own_loop_gives_what_it_is_asked_for(name: str) -> None:
    """In Hz, percent, Nm or volts: its line has nothing to do with it."""
    configuration = packaged(name)
    limits, loop = configuration.drive.limits, PlantLoop(configuration, Belt())
    for wanted in (limits.boost_reference_max_V, limits.boost_reference_min_V):
        for _ in range(1000):
            loop.step(Command(0.0, wanted, bridge=True))
        assert loop.voltage_V == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("asked", [30.0, 5.0, 0.0])
def test_a_simulated_inverter_gives_the_few_hertz_that_it_is_asked_for(asked: float) -> None:
    settings = DeviceSettings(line_drift_Hz=0.0, initial_voltage_V=20.0)
    drive = build_drive(packaged("siemens-v20"), settings, lambda *_, **__: None)
    for tick in range(1000):
        drive.command(asked, bridge=True, now_s=0.01 * tick)
        drive.tick(0.01 * (tick + 1))
    assert drive.world.boost.voltage_V == pytest.approx(asked, abs=1e-3)


@pytest.mark.parametrize("step_s", sample([0.5, None, 1e-3], 1))
def test_a_plant_is_commissioned_and_then_simulated(step_s: float | None) -> None:
    """A motor of more friction than the example's, a tenth of its inertia, and a fast sensor."""
    small = MotorParameters(friction_Nms=0.02, disk_kgm2=0.041, filter_s=2.0)

    def plant() -> ReferenceMotor:
        made = ReferenceMotor(1) if step_s is None else AtOwnStep(1, step_s)
        made.motor = Motor(small)
        return made

    true = Motor(small).model(0.25, 1.0)
    before = EXAMPLES / "motor.toml"
    found = commission(before, plant(), patience_s=10.0)
    model = found.proposal.model
    assert model["gain"].value == pytest.approx(true["gain"], rel=0.02)
    total_s = model["tau_motor_s"].value + model["tau_filter_s"].value
    assert total_s == pytest.approx(true["tau_motor_s"] + true["tau_filter_s"], rel=0.1)
    run = simulate(found.proposal.configuration, plant(), 2.8, 60.0)
    assert run.slow.filter(run.slow["time_s"] > 30.0)["output"].to_numpy() == pytest.approx(
        2.8, abs=0.02
    )
    assert "commission" not in " ".join(run.slow["reason"].to_list())


def test_a_plant_that_does_not_respond_is_refused() -> None:
    class Dead:
        def step(self, boost_voltage_V: float, duration_s: float) -> tuple[float, float]:
            return 1.0, 0.0 * boost_voltage_V * duration_s

    with pytest.raises(CommissionError, match="no response"):
        commission(EXAMPLES / "motor.toml", Dead(), patience_s=1.0)
