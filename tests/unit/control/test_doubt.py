"""A load that takes speed away, and what is shown of a load that may have changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.integration.closed_loop.bench import MOTOR, TICKS, TICK_s
from tests.unit.control.learning import WATCHED, learn_course
from tests.unit.control.systems import Array

LEARNING = replace(WATCHED, settle_periods=30)
TURNS, DROOP_Ohm = 0.25, 1.0
CHANGE_s, REST_s = 330, 420
TRUTH = {1: (0.011, 21.7, 117.0), 3: (0.011, 45.1, 351.0)}
Row = tuple[int, list[float], list[float], bool]


def course(
    *, dropped: bool, seconds: int = 520, disks: int = 3, noise: float = 2e-4
) -> tuple[Array, Array]:
    """Voltage and output of a motor under a square wave, at last at rest; its disks change."""
    motor = Motor(MotorParameters(dropped_at_rest=dropped))
    motor.settle(TURNS * 280.0, DROOP_Ohm)
    random = np.random.default_rng(12)
    voltages, outputs = [280.0], [motor.output]
    for n in range(seconds * TICKS):
        second = n // TICKS
        if n == CHANGE_s * TICKS:
            motor.resize(float(disks), 0.0)
        voltage = 280.0 + (12.0 if min(second, REST_s) // 60 % 2 else 0.0)
        motor.drive(TURNS * voltage, DROOP_Ohm, TICK_s)
        voltages.append(voltage)
        outputs.append(motor.output)
    return np.array(voltages), np.array(outputs) + noise * random.normal(size=len(outputs))


def learn(voltages: Array, outputs: Array, learning: EstimatorSettings = LEARNING) -> list[Row]:
    """Learn a course; second, values, shown deviations and doubt of each slow period."""
    estimator = LambdaEstimator(learning, MOTOR, 2)
    rows, samples = [], (voltages, outputs)
    for n in learn_course(estimator, samples, tick_s=TICK_s, ticks=TICKS, samples=90):
        values = MOTOR.physical(*estimator.regression.model(estimator.estimate.theta))
        shown = estimator.shown_deviations(values)
        rows.append((n // TICKS, values, shown, estimator.is_doubtful()))
    return rows


def worst(row: Row, disks: int) -> float:
    """The largest relative error of a row."""
    return float(np.max(np.abs(np.array(row[1]) / TRUTH[disks] - 1.0)))


def holds(row: Row, disks: int) -> bool:
    """Whether every shown interval of a row holds the truth."""
    errors = np.abs(np.array(row[1]) - TRUTH[disks])
    return bool(np.all(errors <= 1.96 * np.array(row[2])))


def test_a_disk_that_takes_speed_away_is_found_within_one_cycle() -> None:
    rows = learn(*course(dropped=True))
    assert worst(rows[CHANGE_s - 1], 1) < 0.02
    assert worst(rows[CHANGE_s + 119], 3) < 0.05


@pytest.mark.parametrize("dropped", [True, False])
def test_the_shown_intervals_hold_the_new_load_while_it_is_not_known(*, dropped: bool) -> None:
    rows = learn(*course(dropped=dropped))
    after = [holds(row, 3) for row in rows if CHANGE_s + 10 < row[0] < CHANGE_s + 120]
    assert np.mean(after) > 0.9


def test_at_rest_the_load_that_was_learnt_is_in_doubt_and_a_movement_ends_that() -> None:
    rows = learn(*course(dropped=False, disks=1))
    resting, moving = rows[-1], rows[370]
    assert resting[3]
    assert not moving[3]
    assert resting[2][1] > 0.5 * resting[1][1]
    assert moving[2][1] < 0.05 * moving[1][1]
    assert resting[2][0] < 0.05 * resting[1][0]  # the gain shows at rest
