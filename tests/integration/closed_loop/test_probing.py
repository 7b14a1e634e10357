"""Probing in closed loop: a load that changes while nobody moves the set-point."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.analysis.replay import replay
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.settings import Probing
from adaptdrive.control.signals import Command, Measurement, Mode, Order, Shape, Waveform
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.accounts import state_report
from adaptdrive.runtime.reports import LoadReport, StopWord, TickReport
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    SetMode,
    SetSetpoint,
    SetWaveform,
)
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import OperatedDrive
from adaptdrive_sim.world import NoiseParameters, World
from tests.integration.closed_loop.life import CYCLE_S, HIGH, LOW, STEP, periods, started, wait
from tests.support import sample
from tests.unit.recording.material import INFO, make_batch, record_messages

PROBED = {"load": {"probe_share": 0.02}}
AMPLITUDE = 0.02 * 4.5
KNOWN_S = 550.0
"""300 s until information is old, 10 s at rest, and a probe of 160 s; the rest is margin."""


def motor_drive(changes: dict[str, dict[str, Any]], noise: float, seed: int) -> OperatedDrive:
    """A motor at rest on 3 V under adaptive control."""
    noises = NoiseParameters(sigma=noise * STEP)
    world = World(Motor(MotorParameters()), noise=noises, seed=seed)
    world.settle(world.boost_voltage_for(LOW))
    drive = started("motor", world, Mode.ADAPTIVE, changes)
    drive.carry_out(SetSetpoint(LOW))
    return drive


def learnt_drive(changes: dict[str, dict[str, Any]], noise: float, seed: int) -> OperatedDrive:
    """The same, with two cycles of a wave behind it."""
    drive = motor_drive(changes, noise, seed)
    drive.carry_out(SetWaveform(Waveform(Shape.SQUARE, LOW, HIGH, CYCLE_S)))
    wait(drive, 2.0 * CYCLE_S)
    drive.carry_out(SetSetpoint(LOW))
    wait(drive, 30.0)
    return drive


def motor_of(drive: OperatedDrive) -> Motor:
    assert isinstance(drive.world.load, Motor)
    return drive.world.load


def shift(drive: OperatedDrive) -> float:
    """How far the set-point is moved; NaN while the load is not probed."""
    assert drive.decision is not None
    return drive.decision.probe


def overshoot(drive: OperatedDrive) -> float:
    """Overshoot of a step to 3.2 V, over the step."""
    drive.carry_out(SetSetpoint(HIGH))
    return (max(drive.world.true_output for _ in periods(drive, 60.0)) - HIGH) / STEP


def wait_for_a_probe(drive: OperatedDrive, longest_s: float = 600.0) -> None:
    """Run until the set-point is moved."""
    assert any(abs(shift(drive)) > 0.0 for _ in periods(drive, longest_s))


@pytest.mark.proof
@pytest.mark.parametrize("seed", [71, 72])
def test_disks_that_nobody_saw_fall_are_known_before_the_next_step(seed: int) -> None:
    drive = learnt_drive(PROBED, 0.02, seed)
    motor_of(drive).disks = 3
    furthest = max(abs(drive.world.true_output - LOW) for _ in periods(drive, KNOWN_S))
    assert drive.decision is not None
    found = drive.decision.estimates["tau_sum_s"]
    assert found.value == pytest.approx(45.1, rel=0.05)
    assert drive.decision.controller is Mode.ADAPTIVE
    assert math.isnan(shift(drive))
    assert furthest < 1.5 * AMPLITUDE
    assert overshoot(drive) < 0.05


@pytest.mark.proof
@pytest.mark.parametrize("seed", [71, 77000101, 77000201, 77000204])
def test_without_probing_they_are_not_known_and_operators_are_told(seed: int) -> None:
    """Noise shows nothing of them, or too little for the adaptive controller to stay in force."""
    drive = learnt_drive({}, 0.02, seed)
    assert state_report(drive.machine, drive.decision, StopWord.AWAITED).reason == ""
    motor_of(drive).disks = 3
    wait(drive, KNOWN_S)
    assert drive.decision is not None
    report = state_report(drive.machine, drive.decision, StopWord.AWAITED)
    assert report.reason == drive.decision.reason
    if drive.decision.controller is Mode.ADAPTIVE:
        assert drive.decision.estimates["tau_sum_s"].value == pytest.approx(21.7, rel=0.05)
        assert "nothing has shown it for over 300 slow periods" in report.reason
    else:
        assert report.reason


def test_a_movement_ends_what_operators_are_told_of_a_load_at_rest() -> None:
    drive = learnt_drive({}, 0.002, 76)
    wait(drive, 330.0)
    told = state_report(drive.machine, drive.decision, StopWord.AWAITED).reason
    assert told.startswith("the load may have changed: ")
    drive.carry_out(SetSetpoint(HIGH))
    wait(drive, 10.0)
    assert state_report(drive.machine, drive.decision, StopWord.AWAITED).reason == ""


def course(
    changes: dict[str, dict[str, Any]], waveform: Waveform | None
) -> list[tuple[float, float]]:
    """V_c and output in each slow period of 400 s, at rest or under a wave, with noise."""
    drive = motor_drive(changes, 0.02, 73)
    drive.carry_out(SetWaveform(waveform))
    found = []
    for _ in periods(drive, 400.0):
        assert drive.decision is not None
        found.append((drive.decision.boost_reference_V, drive.world.true_output))
    return found


@pytest.mark.proof
def test_a_waveform_is_never_moved() -> None:
    slow = Waveform(Shape.SQUARE, LOW, HIGH, 700.0)
    assert course(PROBED, slow) == course({}, slow)


@pytest.mark.proof
def test_at_rest_it_is_off_unless_it_is_asked_for() -> None:
    off = course({"load": {"probe_share": 0.0}}, None)
    assert off == course({}, None) != course(PROBED, None)


@pytest.mark.parametrize(
    "request_", sample([SetSetpoint(3.1), Disable(), SetMode(Mode.MANUAL), SetMode(Mode.FIXED)], 1)
)
def test_operators_see_it_and_end_it_at_once(request_: Request) -> None:
    drive = motor_drive(PROBED, 0.002, 74)
    wait_for_a_probe(drive)
    report = state_report(drive.machine, drive.decision, StopWord.AWAITED)
    assert "probing: the set-point is moved by +0.09" in report.reason
    drive.carry_out(request_)
    assert all(not abs(shift(drive)) > 0.0 for _ in periods(drive, 20.0))


@pytest.mark.proof
def test_noise_that_hides_the_load_is_not_probed_for_ever() -> None:
    drive = motor_drive({"load": {"probe_share": 0.005}}, 0.3, 75)
    moved = [abs(shift(drive)) > 0.0 for _ in periods(drive, 1200.0)]
    assert 0.0 < sum(moved) / len(moved) < 0.25
    assert drive.machine.trip is None


@dataclass
class Recorded:
    """What a recorder would keep of a run."""

    ticks: list[TickReport] = field(default_factory=list)
    slow: list[LoadReport] = field(default_factory=list)


class RecordedDrive(OperatedDrive):
    """A drive under adaptive control that keeps what it did."""

    def __init__(self, configuration: Configuration, world: World) -> None:
        self.kept = Recorded()
        super().__init__(configuration, world)
        self.tick()
        self.carry_out(Enable())
        self.carry_out(SetMode(Mode.ADAPTIVE))

    def session(self, folder: Path) -> Session:
        """What was recorded of it."""
        directory = create_session(folder, INFO, "")
        batch = make_batch(self.kept.ticks, self.kept.slow, last=True)
        record_messages(directory, Header(INFO, ""), batch)
        return read_session(directory)

    def control(self, measurement: Measurement, order: Order) -> tuple[Command, bool]:
        command, decided = super().control(measurement, order)
        applied_k = self._schedule.applied_k
        number = len(self.kept.ticks)
        self.kept.ticks.append(
            TickReport(number, measurement, order, applied_k, command, 0.0, math.nan)
        )
        if decided and self.snapshot is not None and self.decision is not None:
            self.kept.slow.append(LoadReport(self.snapshot, self.decision))
        return command, decided


@pytest.mark.proof
def test_a_probe_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    tables = example_tables("motor.toml")
    tables["load"] |= PROBED["load"]
    configuration = validate_configuration(tables, EXAMPLES / "motor.toml")
    world = World(Motor(MotorParameters()), noise=NoiseParameters(sigma=2e-3))
    world.settle(world.boost_voltage_for(LOW))
    drive = RecordedDrive(configuration, world)
    wait_for_a_probe(drive)
    wait(drive, 60.0)
    session = drive.session(tmp_path)
    controller = Controller(controller_settings(configuration), build_load(configuration))
    report = replay(session, controller)
    assert report.exact
    assert report.differing_decisions == 0
    assert report.slow_steps == len(drive.kept.slow)
    unprobed = replace(controller_settings(configuration), probing=Probing())
    other = Controller(unprobed, build_load(configuration))
    assert not replay(session, other).exact
