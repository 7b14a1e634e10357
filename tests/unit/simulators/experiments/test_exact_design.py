"""What the daemon's default design reaches in the paper's experiment, whatever the noise."""

from __future__ import annotations

import statistics

import pytest

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import convergence_cycles, cycles, run_case
from adaptdrive_sim.experiments.experiment import MOTOR
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import SHORT_LAST_CYCLES, SHORT_MOTOR, make_case

ORACLE = 0.030
"""Model error with three disks of a noise-free controller that knows the load."""


def error(record: Run) -> float:
    """Model error in the last cycle, with three disks, as a fraction of the step."""
    return cycles(MOTOR, "exact", record)[-1].model_error_rms


def runs(disturbance: NoiseParameters) -> list[Run]:
    return [
        run_case(make_case(MOTOR, "adaptive", "exact", disturbance=disturbance, seed=seed))
        for seed in range(20)
    ]


@pytest.fixture(scope="module")
def silent() -> Run:
    return run_case(make_case(SHORT_MOTOR, "adaptive", "exact", disturbance=NoiseParameters(0.0)))


def test_without_noise_only_saturation_is_left_of_the_model_error(silent: Run) -> None:
    judged = cycles(SHORT_MOTOR, "exact", silent)
    one, two, three = (judged[i].model_error_rms for i in SHORT_LAST_CYCLES)
    assert one < 0.003
    assert two < 0.008
    assert three < 1.10 * ORACLE


def test_a_change_of_the_load_does_not_show(silent: Run) -> None:
    assert max(cycle.overshoot for cycle in cycles(SHORT_MOTOR, "exact", silent)) < 0.02


@pytest.mark.proof
def test_spikes_stop_mattering() -> None:
    records = runs(NoiseParameters(0.002, 0.02, 0.1))
    found = [error(record) for record in records]
    assert statistics.median(found) <= 1.10 * ORACLE
    assert max(found) <= 1.25 * ORACLE
    for record in records:
        for change_s in MOTOR.changes:
            taken = convergence_cycles(MOTOR, record, change_s)
            assert taken is not None
            assert taken <= 1.0


@pytest.mark.proof
@pytest.mark.parametrize(("noise", "factor"), [(0.02, 1.15), (0.05, 1.40)])
def test_noise_stops_mattering(noise: float, factor: float) -> None:
    found = [error(record) for record in runs(NoiseParameters(noise))]
    assert statistics.median(found) <= factor * ORACLE
