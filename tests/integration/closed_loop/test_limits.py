"""Steps after idle phases, set-points at the edge, and loads that coast below it."""

from __future__ import annotations

import re

import pytest

from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.requests import SetSetpoint, SetWaveform
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from adaptdrive_sim.site import OperatedDrive
from tests.integration.closed_loop.life import load_world, settling_s, started, wait
from tests.support import sample


def scaled(gain: float, mode: Mode) -> OperatedDrive:
    """A motor whose gain is so many times that of its model, at rest on 3 V."""
    nominal = MotorParameters()
    motor = Motor(MotorParameters(tachometer_Vs=gain * nominal.tachometer_Vs))
    world = load_world(motor)
    world.settle(world.boost_voltage_for(3.0))
    return started("motor", world, mode)


NOMINAL_S = {"motor": 30.0, "bath": 420.0}
"""Settling of the longest step from rest at once after `enable`; V_c is at its limits for most."""


def idle_then_step(name: str, idle_s: float, target: float) -> tuple[float, float]:
    """Settling time of a step after idling, and how far the load moved while idle."""
    load = Motor(MotorParameters()) if name == "motor" else Bath(BathParameters())
    drive = started(name, load_world(load), Mode.ADAPTIVE)
    assert drive.machine.coasting
    wait(drive, idle_s)
    moved = abs(drive.world.true_output)
    taken_s = settling_s(drive, target, 4.0 * NOMINAL_S[name])
    assert drive.machine.trip is None
    assert drive.decision is not None
    assert "fell back" not in drive.decision.reason
    return taken_s, moved


@pytest.mark.parametrize(
    ("name", "idle_s", "target"),
    sample([("motor", 120.0, 3.0), ("bath", 600.0, 12.0), ("bath", 7200.0, 12.0)], 1),
)
def test_a_step_after_idling_is_as_fast_as_any_and_idling_moves_nothing(
    name: str, idle_s: float, target: float
) -> None:
    taken_s, moved = idle_then_step(name, idle_s, target)
    assert taken_s <= 1.3 * NOMINAL_S[name]
    assert moved == 0.0


LINEAR_S = 22.0
"""Settling of four poles at 0.7 with T_k = 1 s to 5 %."""


@pytest.mark.parametrize("gain", [1.05, 0.95])
@pytest.mark.parametrize("mode", sample([Mode.ADAPTIVE, Mode.FIXED], 1))
def test_a_step_after_a_saturated_phase_is_as_fast_as_any(gain: float, mode: Mode) -> None:
    drive = scaled(gain, mode)
    drive.carry_out(SetSetpoint(2.2 if gain > 1.0 else 4.4))
    wait(drive, 200.0)
    assert drive.decision is not None
    assert drive.decision.boost_reference_V in (200.0, 400.0)
    assert settling_s(drive, 3.0, 100.0) <= 1.3 * LINEAR_S


@pytest.mark.parametrize(
    ("gain", "value", "within"),
    [(0.95, 4.3, "2.*…4.1.*|2.*…4.2.*"), (1.05, 2.2, "2.3.*…4.*")],
)
@pytest.mark.parametrize("mode", sample([Mode.ADAPTIVE, Mode.FIXED], 1))
def test_a_set_point_that_only_the_model_reaches_neither_trips_nor_latches(
    gain: float, value: float, within: str, mode: Mode
) -> None:
    drive = scaled(gain, mode)
    drive.carry_out(SetSetpoint(value))
    wait(drive, 480.0)
    assert drive.machine.trip is None
    assert drive.decision is not None
    assert "fell back" not in drive.decision.reason
    text = f"set-point {value:g} V is outside ({within}) V, which V_c can hold"
    assert re.fullmatch(text, drive.machine.obstacle)


@pytest.mark.parametrize("value", [0.5, 2.15, 4.45])
def test_a_set_point_beyond_what_V_c_can_hold_is_refused(value: float) -> None:
    drive = started("motor", load_world(Motor(MotorParameters())))
    with pytest.raises(RefusedError, match=f"{value:g} V is outside 2.2…4.4 V"):
        drive.carry_out(SetSetpoint(value))
    wave = Waveform(Shape.SQUARE, 3.0, value, 60.0)
    with pytest.raises(RefusedError, match=r"waveform high = .* outside 2.2…4.4 V"):
        drive.carry_out(SetWaveform(wave))
    assert drive.machine.coasting


def test_a_set_point_of_0_lets_the_load_coast_and_the_next_one_catches_it() -> None:
    world = load_world(Motor(MotorParameters()))
    world.settle(world.boost_voltage_for(3.0))
    drive = started("motor", world)
    drive.carry_out(SetSetpoint(0.0))
    for _ in range(round(10.0 * 120)):
        drive.tick()
        assert not world.bridge
        assert world.current_scale_S == 0.0
    assert 0.0 < world.true_output < 2.8
    drive.carry_out(SetSetpoint(3.0))
    wait(drive, 60.0)
    assert world.true_output == pytest.approx(3.0, abs=0.01)


def test_the_reach_follows_what_is_learnt_of_the_load() -> None:
    drive = scaled(0.9, Mode.ADAPTIVE)
    assert (drive.machine.reach.low, drive.machine.reach.high) == (2.2, 4.4)
    drive.carry_out(SetWaveform(Waveform(Shape.SQUARE, 3.0, 3.2, 60.0)))
    wait(drive, 300.0)
    true_low, true_high = (0.9 * 0.011 * limit_V for limit_V in (200.0, 400.0))
    assert drive.machine.reach.low == pytest.approx(true_low, rel=0.02)
    assert drive.machine.reach.high == pytest.approx(true_high, rel=0.02)
    with pytest.raises(RefusedError, match="which V_c can hold"):
        drive.carry_out(SetSetpoint(4.3))
    drive.carry_out(SetSetpoint(2.1))
