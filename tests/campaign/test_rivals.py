"""The shortest form of the comparison with the controllers that a user would otherwise choose."""

from __future__ import annotations

import numpy as np
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.run import run_held
from tests.benchmarks.rivals.cases import CASES
from tests.benchmarks.rivals.runs import figures

pytestmark = pytest.mark.slow

SEED = 44_900_000


def test_a_rival_meets_the_plant_that_the_daemon_meets() -> None:
    stand = CASES["I"].stand(SEED)
    expected = stand.run(Mode.ADAPTIVE).trace
    course = stand.course(Mode.ADAPTIVE)
    voltages = expected[:, bench.REFERENCE_V].tolist()
    found = run_held(stand.site(), course, lambda k, _output, _applied: voltages[k])
    np.testing.assert_allclose(found, expected[:, : bench.ADAPTIVE], rtol=1e-9, equal_nan=False)


@pytest.mark.parametrize("rival", ["fixed", "SIMC PI", "relay PID"])
def test_with_three_disks_adaptive_follows_better(rival: str) -> None:
    assert figures(CASES["B"], SEED, "adaptive").rms < 0.25 * figures(CASES["B"], SEED, rival).rms


@pytest.mark.parametrize("name", ["A", "B"])
def test_adaptive_comes_near_to_a_controller_that_knows_load_and_limits(name: str) -> None:
    known, adaptive = (figures(CASES[name], SEED, one).rms for one in ("MPC", "adaptive"))
    assert adaptive < known + 2.0
