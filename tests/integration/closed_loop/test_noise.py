"""Noise of the output in the input of the load, and what keeps it out."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from tests.integration.closed_loop.life import CYCLE_S, STEP, Motion, Rows

LEARNT_s, AT_REST_s = 480.0, 35.0
NOISE = 0.05 * STEP


def voltage_noise_V(rows: Rows) -> float:
    """Standard deviation of V_c at rest, in the second part of each half cycle."""
    times_s, voltages_V = np.array(rows.time_s), np.array(rows.voltage_V)
    halves = (times_s // (0.5 * CYCLE_S)).astype(int)
    resting = (times_s >= LEARNT_s) & (times_s % (0.5 * CYCLE_S) >= AT_REST_s)
    assert (np.array(rows.adaptive)[resting]).mean() > 0.8
    chosen = [voltages_V[resting & (halves == half)] for half in np.unique(halves[resting])]
    return float(np.sqrt(np.mean([np.var(part) for part in chosen])))


def test_noise_shakes_the_voltage_by_4_percent_of_its_range_at_most() -> None:
    motion = Motion(noise=NOISE, seed=71, duration_s=720.0)
    assert 0.6 * 8.0 <= voltage_noise_V(motion.run(Mode.ADAPTIVE)) <= 1.25 * 8.0


@pytest.mark.proof
@pytest.mark.parametrize("resolution", [0.0, 0.01])
def test_a_coarse_sensor_does_not_make_the_loop_hunt(resolution: float) -> None:
    """Whether its resolution is configured or has to be found (0.068 where it is neither)."""
    rows = Motion(quantum=0.01).run(Mode.ADAPTIVE, changes={"load": {"resolution": resolution}})
    assert rows.in_force(LEARNT_s) >= 0.95
    assert rows.model_error(3, LEARNT_s) <= 0.035
