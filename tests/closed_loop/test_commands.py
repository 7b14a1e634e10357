"""No sequence of accepted commands trips a healthy drive, latches, or moves its load unasked."""

from __future__ import annotations

import random

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.requests import Disable, Enable, Request, SetMode, SetPole, SetSetpoint
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.plants.load import SimulatedLoad
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.closed_loop.commands import problems
from tests.closed_loop.life import load_world, started, wait
from tests.support import compiled, sample


def test_no_sequence_of_set_points_trips_latches_or_moves_a_motor_unasked() -> None:
    assert problems("motor", range(2), compiled=False) == []


@compiled
@pytest.mark.parametrize("name", ["motor", "bath"])
def test_nor_does_any_of_a_hundred(name: str) -> None:
    assert problems(name, range(100), compiled=True) == []


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


@pytest.mark.parametrize(("name", "wait_s"), [("motor", 12.0), ("bath", 60.0), ("battery", 12.0)])
@pytest.mark.parametrize("seed", sample(range(3), 1))
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
