"""Preview in closed loop: a waveform whose steps need more than V_c has."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from adaptdrive.analysis.replay import replay
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Shape, Waveform
from adaptdrive.runtime.requests import SetSetpoint, SetWaveform
from adaptdrive_sim.parameters import EXAMPLES, example_tables
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import NoiseParameters, World
from tests.integration.closed_loop.life import wait
from tests.integration.closed_loop.test_probing import RecordedDrive

LOW, HIGH, CYCLE_S = 2.6, 4.3, 120.0


def configuration() -> Configuration:
    return validate_configuration(example_tables("motor.toml"), EXAMPLES / "motor.toml")


@cache
def run(shape: Shape, preview: bool) -> RecordedDrive:
    """Three cycles under adaptive control."""
    noise = NoiseParameters(sigma=2e-3 * (HIGH - LOW))
    world = World(Motor(MotorParameters()), noise=noise, seed=3)
    world.settle(world.boost_voltage_for(LOW))
    drive = RecordedDrive(configuration(), world)
    drive.carry_out(SetWaveform(Waveform(shape, LOW, HIGH, CYCLE_S), preview))
    wait(drive, 3.0 * CYCLE_S)
    return drive


def deviation(drive: RecordedDrive) -> float:
    """Deviation from the response asked for in the last two cycles, rms, over the step."""
    slow = drive.kept.slow
    references = np.array([one.snapshot.order.reference for one in slow])
    outputs = np.array([one.snapshot.output for one in slow])
    asked = LOW + lfilter([0.3**4], np.poly([0.7] * 4), references - LOW)
    return float(np.std((outputs - asked)[-240:])) / (HIGH - LOW)


@pytest.mark.proof
def test_a_waveform_at_the_edge_of_the_voltage_is_followed_better_by_half() -> None:
    with_it, without = deviation(run(Shape.SQUARE, True)), deviation(run(Shape.SQUARE, False))
    assert with_it < 0.6 * without


def test_what_the_controller_knows_to_come_does_come() -> None:
    drive = run(Shape.SQUARE, True)
    waved = [one for one in drive.kept.ticks if one.order.moving]  # another test may go on
    tick_s = 1.0 / 120.0
    for earlier in (0, 1, 119, 120, 7000):
        shown = waved[-1 - earlier]
        known = waved[-1].order.moving
        assert known is not None
        elapsed_s = (shown.measurement.tick - known.begin_tick) * tick_s
        assert known.form.value(elapsed_s) == shown.order.reference


def test_a_set_point_ends_what_the_controller_knows_to_come() -> None:
    drive = run(Shape.SQUARE, True)
    count = len(drive.kept.ticks)
    drive.carry_out(SetSetpoint(3.0))
    wait(drive, 2.0)
    assert {one.order.moving for one in drive.kept.ticks[count + 1 :]} == {None}


def test_it_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    drive = run(Shape.SQUARE, True)
    own = configuration()
    controller = Controller(controller_settings(own), build_load(own))
    report = replay(drive.session(tmp_path), controller)
    assert report.exact
    assert report.differing_decisions == 0
    assert report.slow_steps == len(drive.kept.slow) > 2.5 * CYCLE_S
    assert math.isfinite(drive.kept.slow[-1].decision.boost_reference_V)


def test_a_ramp_is_known_ahead_and_replayed_bit_for_bit(tmp_path: Path) -> None:
    own = configuration()
    world = World(Motor(MotorParameters()), seed=3)
    world.settle(world.boost_voltage_for(LOW))
    drive = RecordedDrive(own, world)
    wait(drive, 5.0)
    drive.carry_out(SetSetpoint(HIGH, 0.1))
    wait(drive, 40.0)
    slow, ticks = drive.kept.slow, own.ticks_per_period
    later = {one.measurement.tick: one.order.reference for one in drive.kept.ticks}
    ramped = [one.snapshot for one in slow if one.snapshot.upcoming]
    assert len(ramped) == pytest.approx((HIGH - LOW) / 0.1 / own.load.period_s, abs=1.0)
    for shown in ramped:
        known = [later.get(shown.tick + i * ticks) for i in range(1, len(shown.upcoming) + 1)]
        came = [one for one in known if one is not None]
        assert came == list(shown.upcoming[: len(came)])
    assert drive.reference == HIGH
    report = replay(drive.session(tmp_path), Controller(controller_settings(own), build_load(own)))
    assert report.exact
    assert report.differing_decisions == 0
