"""A charge with a ripple of its current: adaptive for most of it, within its bounds."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.runtime.requests import SetSetpoint
from adaptdrive_sim.plants.battery import Battery, BatteryParameters
from adaptdrive_sim.world import NoiseParameters, World
from tests.integration.closed_loop.life import periods, started

CURRENT_A = 12.0
SHARE = 0.008
LIMIT_V = 82.0
NAMES = ("direct_S", "gain_S", "tau_s")

pytestmark = pytest.mark.proof


@dataclass
class ChargeCourse:
    """What a charge brought in each slow period from its 60th second on."""

    current_A: list[float] = field(default_factory=list)
    voltage_V: list[float] = field(default_factory=list)
    shift_A: list[float] = field(default_factory=list)
    adaptive: list[bool] = field(default_factory=list)
    estimates: list[list[float]] = field(default_factory=list)
    completed: bool = False

    @property
    def constant(self) -> slice:
        """The part at constant current: the voltage limit is not reached yet."""
        return slice(0, next(i for i, v in enumerate(self.voltage_V) if v > LIMIT_V))


@cache
def charged(seed: int, share: float = SHARE) -> ChargeCourse:
    """Charge the example's battery from 30 % until it is full."""
    plant = Battery(BatteryParameters())
    world = World(plant, noise=NoiseParameters(sigma=0.02), seed=seed)
    changes: dict[str, dict[str, Any]] = {"load": {"probe_share": share}}
    drive = started("battery", world, Mode.ADAPTIVE, changes)
    drive.carry_out(SetSetpoint(CURRENT_A))
    found, began_s = ChargeCourse(), drive.time_s
    for _ in periods(drive, 8000.0):
        found.completed = drive.completed
        if drive.completed:
            break
        if drive.time_s < began_s + 60.0:
            continue
        assert drive.decision is not None
        found.current_A.append(plant.output)
        found.voltage_V.append(plant.terminal_voltage_V)
        found.shift_A.append(float(np.nan_to_num(drive.decision.probe)))
        found.adaptive.append(drive.decision.controller is Mode.ADAPTIVE)
        found.estimates.append([drive.decision.estimates[name].value for name in NAMES])
    assert drive.machine.trip is None
    return found


@pytest.mark.parametrize("seed", [61, 62])
def test_a_charge_is_adaptive_for_most_of_its_constant_current(seed: int) -> None:
    found = charged(seed)
    constant = found.constant
    assert np.mean(found.adaptive[constant]) > 0.5
    current_A = np.array(found.current_A[constant])
    assert np.ptp(current_A) < 0.01 * CURRENT_A
    assert max(current_A) < 1.002 * CURRENT_A
    adaptive = np.array(found.adaptive)[constant]
    truth = list(Battery(BatteryParameters()).model(0.25, 1.0).values())
    errors = np.abs(np.array(found.estimates)[constant][adaptive] / truth - 1.0)
    assert np.max(errors[:, 0]) < 0.10
    assert np.quantile(errors, 0.9) < 0.25


def test_no_ripple_at_the_voltage_limit() -> None:
    found = charged(61)
    end = found.constant.stop
    assert any(found.shift_A[:end])
    assert not any(found.shift_A[end + 5 :])
    assert max(found.voltage_V) < 1.002 * LIMIT_V
    assert found.completed


def test_off_it_moves_nothing_and_knows_nothing() -> None:
    found = charged(64, share=0.0)
    assert not any(found.shift_A)
    assert not any(found.adaptive[found.constant])
