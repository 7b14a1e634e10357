"""Disturbance or load: torque that comes and goes is not taken for another motor."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive_sim.plants.motor import Motor
from tests.integration.closed_loop.life import (
    STEP,
    Motion,
    Rows,
    disks_at,
    random_torque,
    sinusoidal_torque,
    torque_steps,
)

LEARNT_s = 240.0
QUIET = 0.002 * STEP


@pytest.fixture(scope="module")
def stepped() -> Rows:
    return Motion(noise=QUIET, seed=51, duration_s=600.0).run(Mode.ADAPTIVE, torque_steps)


def test_steps_of_torque_leave_the_adaptive_controller_in_force(stepped: Rows) -> None:
    assert stepped.model_error(3, LEARNT_s) <= 0.033
    assert stepped.in_force(LEARNT_s) >= 0.95


@pytest.mark.proof
@pytest.mark.parametrize("seed", [52, 53, 60103, 60209])
def test_so_do_they_with_noise_of_two_percent(seed: int) -> None:
    rows = Motion(noise=0.02 * STEP, seed=seed).run(Mode.ADAPTIVE, torque_steps)
    assert rows.model_error(3, LEARNT_s) <= 0.04
    assert rows.in_force(LEARNT_s) >= 0.90


@pytest.mark.proof
@pytest.mark.parametrize("pattern", [61, 62])
def test_torque_at_random_is_no_worse_than_one_and_a_half_times_a_known_load(pattern: int) -> None:
    motion, event = Motion(noise=QUIET, seed=51), random_torque(pattern)
    known = {"load.model": {"tau_motor_s": 35.1}}
    best = motion.run(Mode.FIXED, event, known).model_error(3, LEARNT_s)
    assert motion.run(Mode.ADAPTIVE, event).model_error(3, LEARNT_s) <= 1.5 * best


@pytest.mark.proof
@pytest.mark.parametrize("late_s", [0.0, 5.0, 10.0, 15.0, 20.0, 25.0])
def test_a_torque_that_swings_is_no_load(late_s: float) -> None:
    def torque(motor: Motor, time_s: float) -> None:
        sinusoidal_torque(motor, time_s + late_s)

    motion, known = Motion(noise=QUIET, seed=51), {"load.model": {"tau_motor_s": 35.1}}
    best = motion.run(Mode.FIXED, torque, known).model_error(3, LEARNT_s)
    rows = motion.run(Mode.ADAPTIVE, torque)
    assert rows.model_error(3, LEARNT_s) <= max(0.035, 1.1 * best)
    assert rows.in_force(LEARNT_s) >= 0.95


@pytest.mark.proof
def test_another_load_is_found_under_steps_of_torque() -> None:
    change = disks_at((420.0, 1))

    def both(motor: Motor, time_s: float) -> None:
        torque_steps(motor, time_s)
        change(motor, time_s)

    rows = Motion(noise=QUIET, seed=51).run(Mode.ADAPTIVE, both)
    assert rows.in_force(LEARNT_s) >= 0.95
    value, _ = rows.estimates[-1]["tau_sum_s"]
    assert value == pytest.approx(21.7, rel=0.05)


def test_a_torque_at_constant_speed_is_shown_as_an_offset(stepped: Rows) -> None:
    on = [
        row["input_offset"][0]
        for row, t in zip(stepped.estimates, stepped.time_s, strict=True)
        if 530.0 < t < 538.0
    ]
    assert on == pytest.approx([-20.0] * len(on), abs=3.0)
