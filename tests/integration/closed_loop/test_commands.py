"""No sequence of accepted commands trips a healthy drive, latches, or moves its load unasked."""

from __future__ import annotations

import random

import pytest

from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    SetMode,
    SetPole,
    SetSetpoint,
    SetWaveform,
)
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.world import SimulatedLoad
from tests.integration.closed_loop.life import load_world, periods, started, wait
from tests.support import sample

OVERSHOOT = 0.6
"""Overshoot that a fixed controller may have with three times the nominal inertia."""


def a_load(name: str) -> SimulatedLoad:
    plants: dict[str, SimulatedLoad] = {
        "motor": Motor(MotorParameters()),
        "bath": Bath(BathParameters()),
    }
    return plants.get(name) or Battery(BatteryParameters(charge=0.3))


def a_request(draw: random.Random, highest: float) -> Request:
    """Any command, also those that are refused."""
    value = draw.choice([0.0, draw.uniform(0.0, highest)])
    modes = SetMode(draw.choice([Mode.FIXED, Mode.ADAPTIVE]))
    return draw.choice([SetSetpoint(value), SetSetpoint(value), modes, SetPole(0.8), Disable()])


@pytest.mark.parametrize(
    ("name", "wait_s", "seed"),
    sample(
        [
            (name, wait_s, seed)
            for seed in range(3)
            for name, wait_s in (("motor", 12.0), ("bath", 30.0), ("battery", 12.0))
        ],
        3,
    ),
)
def test_any_commands_from_rest_trip_nothing(name: str, wait_s: float, seed: int) -> None:
    draw = random.Random(f"{name} {seed}")
    drive = started(name, load_world(a_load(name)))
    at_rest = drive.world.true_output
    wait(drive, wait_s)
    assert drive.world.true_output == pytest.approx(at_rest, abs=1e-9)
    for _ in range(8):
        try:
            drive.carry_out(a_request(draw, 15.0 if name != "motor" else 5.0))
        except RefusedError:
            continue
        wait(drive, wait_s)
        drive.carry_out(Enable())
        assert drive.machine.trip is None
    wait(drive, wait_s)
    assert drive.machine.trip is None


@pytest.mark.parametrize("seed", sample(range(20), 1))
def test_no_set_points_and_waveforms_trip_latch_or_move_a_motor_unasked(seed: int) -> None:
    """Of any size and noise, with set-points at the ends of the reach oftener than elsewhere."""
    draw = random.Random(seed)
    motor = Motor(MotorParameters())
    motor.resize(draw.uniform(0.8, 2.0), 0.0)
    world = load_world(motor, draw.choice([0.0, 0.005]), seed)
    world.settle(world.boost_voltage_for(3.0))
    drive = started("motor", world, draw.choice([Mode.FIXED, Mode.ADAPTIVE]))
    drive.carry_out(SetSetpoint(3.0))
    asked, seen = [3.0], [3.0]
    for _ in range(4):
        value, other = (draw.choice([draw.uniform(2.0, 4.5), 2.2, 4.4]) for _ in range(2))
        wave = Waveform(draw.choice(list(Shape)), min(value, other), other, draw.uniform(4.0, 60.0))
        try:
            drive.carry_out(SetSetpoint(value) if draw.random() < 0.7 else SetWaveform(wave))
        except RefusedError:
            continue
        for _ in periods(drive, draw.randint(2, 120)):
            asked.append(drive.reference)
            seen.append(drive.world.true_output)
        assert drive.machine.trip is None
        assert drive.decision is not None
        assert "fell back" not in drive.decision.reason
    margin = OVERSHOOT * (max(asked) - min(asked)) + 0.05
    assert min(asked) - margin <= min(seen)
    assert max(seen) <= max(asked) + margin
