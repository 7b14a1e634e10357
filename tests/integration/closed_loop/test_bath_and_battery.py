"""Bath and battery as configured for the daemon, in virtual time: its controller and machine."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import pytest

from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import SetSetpoint, SetWaveform
from adaptdrive_sim.parameters import example_tables
from adaptdrive_sim.plants.bath import Bath, BathParameters
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from tests.integration.closed_loop.life import SMALL_BATH, load_world, periods, started, wait
from tests.support import sample

HALF_s = 240.0
ONE = BatteryParameters()
TWO = BatteryParameters(relaxation_2_Ohm=0.2, relaxation_2_s=300.0)


def overshoots(mode: Mode) -> list[float]:
    """Overshoot of each half wave of 10 and 13 K, with the drain raised in the third."""
    bath = Bath(BathParameters(volume_gal=0.12))
    plant = load_world(bath, 0.02)  # in a fifth of the samples of a slow period
    plant.settle(plant.boost_voltage_for(10.0))
    drive = started("bath", plant, mode, SMALL_BATH)
    wave = Waveform(Shape.SQUARE, 10.0, 13.0, 2 * HALF_s)
    drive.carry_out(SetWaveform(wave, preview=False))
    found = []
    for half in range(5):
        if half == 2:
            bath.fill(0.3, 60.0)
        sign, limit = (1.0, 13.0) if half % 2 == 0 else (-1.0, 10.0)
        found.append(max(sign * (bath.output - limit) / 3.0 for _ in periods(drive, HALF_s)))
    assert drive.machine.trip is None
    return found


def test_an_adaptive_bath_does_not_overshoot_whatever_its_volume() -> None:
    assert max(overshoots(Mode.ADAPTIVE)) < 0.02


@pytest.mark.proof
def test_a_fixed_bath_overshoots_once_it_is_larger() -> None:
    found = overshoots(Mode.FIXED)
    assert max(found[:2]) < 0.01
    assert all(overshoot > 0.07 for overshoot in found[3:])


@pytest.mark.parametrize(
    ("battery", "mode"),
    sample([(ONE, Mode.FIXED), (TWO, Mode.ADAPTIVE), (ONE, Mode.ADAPTIVE), (TWO, Mode.FIXED)], 1),
)
def test_a_battery_is_charged_tapers_and_is_complete(
    battery: BatteryParameters, mode: Mode
) -> None:
    plant = Battery(dataclasses.replace(battery, charge=0.45, capacity_Ah=3.0))
    drive = started("battery", load_world(plant, 0.02), mode)
    drive.carry_out(SetSetpoint(12.0))
    for _ in periods(drive, 40.0):
        assert plant.output < 1.1 * 12.0
    currents, highest_V = [], 0.0
    for _ in periods(drive, 4000.0):
        if drive.completed:
            break
        currents.append(plant.output)
        highest_V = max(highest_V, plant.terminal_voltage_V)
    limit_V = 82.0
    constant = next(i for i, current in enumerate(currents) if current < 0.99 * 12.0)
    assert max(currents) < 1.01 * 12.0
    assert constant > 10
    assert max(currents[constant + 100 :]) < 11.9
    assert highest_V < 1.005 * limit_V
    assert drive.completed
    assert drive.machine.state is State.STANDBY
    assert currents[-1] < 1.05
    assert plant.charge > 0.85
    drive.tick()
    drive.tick()
    assert plant.output == 0.0


def test_the_terminals_of_a_full_battery_pass_their_limit_by_two_percent_at_most() -> None:
    tables = example_tables("battery.toml")
    limit_V = tables["load"]["charge"]["voltage_max_V"]
    plant = Battery(dataclasses.replace(ONE, charge=0.93))
    assert plant.open_circuit_V > limit_V
    drive = started("battery", load_world(plant), Mode.ADAPTIVE)
    drive.carry_out(SetSetpoint(12.6))
    highest_V = 0.0
    while drive.time_s < 30.0:
        drive.tick()
        highest_V = max(highest_V, plant.terminal_voltage_V)
    assert 1.019 * limit_V < highest_V < 1.0205 * limit_V


@pytest.mark.parametrize("mode", sample([Mode.ADAPTIVE, Mode.FIXED], 1))
def test_a_battery_is_charged_while_it_is_learnt_without_filters(mode: Mode) -> None:
    """Such a model has no direct term: that parameter of it is exactly 0."""
    changes: dict[str, dict[str, Any]] = {
        "estimator": {"method": "rls", "settle_s": 5.0},
        "supervisor": {"warm_up_s": 10.0},
    }
    plant = Battery(dataclasses.replace(ONE, charge=0.45))
    drive = started("battery", load_world(plant, 0.02), mode, changes)
    drive.carry_out(SetSetpoint(6.0))
    currents = [plant.output for _ in periods(drive, 60.0)]
    assert drive.machine.state is State.RUNNING, drive.machine.trip
    assert currents[-1] == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize(
    ("charge", "current_A"),
    sample(
        [(0.2, 0.5), (0.65, 5.0), *itertools.product([0.35, 0.5], [0.5, 2.0, 5.0]), (0.2, 5.0)], 2
    ),
)
def test_the_first_current_into_a_battery_overshoots_little(
    charge: float, current_A: float
) -> None:
    plant = Battery(dataclasses.replace(ONE, charge=charge))
    drive = started("battery", load_world(plant, 0.02))
    drive.carry_out(SetSetpoint(current_A))
    highest_A, end_s = 0.0, drive.time_s + 40.0
    while drive.time_s < end_s:
        drive.tick()
        highest_A = max(highest_A, plant.output)
    end_current_A = 1.0
    assert current_A < highest_A < 1.4 * max(current_A, end_current_A)


@pytest.mark.parametrize("battery", sample([TWO, ONE], 1))
def test_the_current_of_a_battery_follows_a_wave_under_adaptive_control(
    battery: BatteryParameters,
) -> None:
    plant = Battery(battery)
    drive = started("battery", load_world(plant, 0.02), Mode.ADAPTIVE)
    drive.carry_out(SetSetpoint(8.0))
    wait(drive, 60.0)
    drive.carry_out(SetWaveform(Waveform(Shape.SQUARE, 6.0, 10.0, 60.0)))
    adaptive, beyond = 0, 0.0
    for _ in periods(drive, 300.0):
        assert drive.decision is not None
        adaptive += drive.decision.controller is Mode.ADAPTIVE
        beyond = max(beyond, plant.output - 10.0, 6.0 - plant.output)
    assert adaptive > 100
    assert beyond < 0.03 * 4.0
    assert drive.decision is not None
    assert drive.decision.estimates["direct_S"].value == pytest.approx(0.25 / 1.2, rel=0.05)


def test_a_steady_current_teaches_nothing_and_says_so() -> None:
    drive = started("battery", load_world(Battery(ONE), 0.02), Mode.ADAPTIVE)
    drive.carry_out(SetSetpoint(12.0))
    wait(drive, 200.0)
    assert drive.decision is not None
    assert drive.decision.controller is Mode.FIXED
    assert "is uncertain" in drive.decision.reason
