"""Nothing winds up at a limit: steps after idle phases, and set-points at the edge."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.runtime.requests import SetSetpoint
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.closed_loop.life import Sensed, load_world, settling_s, started, wait

NOMINAL_S = {"motor": 22.0, "bath": 420.0}
"""Settling of the longest step from a standstill, which is at the limits for most of it."""


def idle_then_step(name: str, idle_s: float, target: float) -> tuple[float, Mode]:
    load = Motor(MotorParameters()) if name == "motor" else Bath(BathParameters())
    drive = started(name, load_world(load), Mode.ADAPTIVE)
    wait(drive, idle_s)
    taken_s = settling_s(drive, target, 4.0 * NOMINAL_S[name])
    assert drive.machine.trip is None
    assert drive.decision is not None
    assert "fell back" not in drive.decision.reason
    return taken_s, drive.decision.controller


@pytest.mark.parametrize("idle_s", [10.0, 120.0, 300.0, 900.0])
def test_a_step_after_idling_is_as_fast_as_any(idle_s: float) -> None:
    taken_s, _ = idle_then_step("motor", idle_s, 3.0)
    assert taken_s <= 1.3 * NOMINAL_S["motor"]


@pytest.mark.parametrize("idle_s", [600.0, 7200.0])
def test_so_is_that_of_a_bath(idle_s: float) -> None:
    taken_s, _ = idle_then_step("bath", idle_s, 12.0)
    assert taken_s <= 1.3 * NOMINAL_S["bath"]


@pytest.mark.parametrize(("first", "then"), [(2.25, 2.15), (4.35, 4.45), (3.0, 2.0)])
@pytest.mark.parametrize("mode", [Mode.FIXED, Mode.ADAPTIVE])
def test_a_reference_beyond_the_edge_neither_trips_nor_latches(
    first: float, then: float, mode: Mode
) -> None:
    world = load_world(Motor(MotorParameters()))
    world.settle(world.boost_voltage_for(first))
    drive = started("motor", world, mode)
    drive.carry_out(SetSetpoint(first))
    wait(drive, 120.0)
    drive.carry_out(SetSetpoint(then))
    wait(drive, 600.0)
    assert drive.machine.trip is None
    assert drive.decision is not None
    assert "fell back" not in drive.decision.reason


def test_a_tachometer_that_sticks_trips() -> None:
    world = Sensed(Motor(MotorParameters()))
    world.settle(world.boost_voltage_for(3.0))
    drive = started("motor", world)
    drive.carry_out(SetSetpoint(3.0))
    wait(drive, 60.0)
    world.stuck_at = 3.0
    drive.carry_out(SetSetpoint(3.5))
    wait(drive, 400.0)
    assert (drive.machine.trip or "").startswith("no response")
