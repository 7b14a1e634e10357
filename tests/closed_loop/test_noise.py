"""Noise of the output in the input of the load, and what keeps it out."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from tests.closed_loop.life import CYCLE_S, STEP, Motion, Rows

LEARNT_s, AT_REST_s = 480.0, 35.0
NOISE = 0.05 * STEP

pytestmark = pytest.mark.slow


def voltage_noise_V(rows: Rows) -> float:
    """Standard deviation of V_c at rest, in the second part of each half cycle."""
    times_s, voltages_V = np.array(rows.time_s), np.array(rows.voltage_V)
    halves = (times_s // (0.5 * CYCLE_S)).astype(int)
    resting = (times_s >= LEARNT_s) & (times_s % (0.5 * CYCLE_S) >= AT_REST_s)
    assert (np.array(rows.adaptive)[resting]).mean() > 0.8
    chosen = [voltages_V[resting & (halves == half)] for half in np.unique(halves[resting])]
    return float(np.sqrt(np.mean([np.var(part) for part in chosen])))


def test_noise_shakes_the_voltage_no_more_than_configured() -> None:
    motion = Motion(noise=NOISE, seed=71)
    free = voltage_noise_V(motion.run(Mode.ADAPTIVE, changes={"load": {"noise_V": 0.0}}))
    assert free > 15.0
    for limit_V in (10.0, 5.0):
        rows = motion.run(Mode.ADAPTIVE, changes={"load": {"noise_V": limit_V}})
        assert 0.6 * limit_V <= voltage_noise_V(rows) <= 1.25 * limit_V


def test_a_coarse_sensor_does_not_make_the_loop_hunt() -> None:
    """Whether its resolution is configured or has to be found (0.068 where it is neither)."""
    motion = Motion(quantum=0.01)
    for resolution in (0.01, 0.0):
        rows = motion.run(Mode.ADAPTIVE, changes={"load": {"resolution": resolution}})
        assert rows.in_force(LEARNT_s) >= 0.95
        assert rows.model_error(3, LEARNT_s) <= 0.035
