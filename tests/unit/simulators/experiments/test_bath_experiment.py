"""The paper's bath experiment: what it claims."""

import pytest

from adaptdrive_sim.experiments.case import Design, convergence_cycles, cycles, run_case
from adaptdrive_sim.experiments.experiment import BATH
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import SEEDS, make_case, outcome

AFTER = slice(2, None)
"""The cycle within which the volume changes, and those after it."""


@pytest.mark.proof
@pytest.mark.parametrize("seed", SEEDS)
def test_the_fixed_controller_overshoots_after_the_change_and_the_adaptive_one_does_not(
    seed: int,
) -> None:
    found = outcome(BATH, ("fixed", "adaptive"), seed=seed)
    fixed, adaptive = found.cycles["fixed"], found.cycles["adaptive"]
    assert max(one.overshoot for one in fixed[:2]) < 0.035
    assert min(one.overshoot for one in fixed[AFTER]) > 0.07
    assert max(one.overshoot for one in adaptive) < 0.035
    assert [one.load for one in fixed] == [1.0, 1.0, 2.5, 2.5, 2.5]
    assert found.records["adaptive"]["adaptive"].tolist().index(True) == 30


@pytest.mark.proof
def test_without_noise_direct_least_squares_finds_the_bath() -> None:
    record = run_case(make_case(BATH, "adaptive", disturbance=NoiseParameters(0.0)))
    before = round(5400.0 / BATH.period_s) - 1
    found = [record[name][before] for name in BATH.nominal().names]
    assert found == pytest.approx(BATH.truth_at(5399.0), rel=5e-3)
    judged = cycles(BATH, "paper", record)
    assert judged[2].overshoot < 0.02
    assert max(one.overshoot for one in judged[3:]) < 0.005


@pytest.mark.proof
def test_under_noise_lm_rls_finds_what_direct_least_squares_misses() -> None:
    direct, filtered = (run_case(make_case(BATH, name)) for name in ("adaptive", "lm_rls"))
    (change,) = BATH.changes
    assert convergence_cycles(BATH, direct, change) is None
    found = convergence_cycles(BATH, filtered, change)
    assert found is not None
    assert found < 2.0


@pytest.mark.proof
def test_the_daemons_own_design_keeps_the_bath_within_the_papers_limits() -> None:
    judged = cycles(BATH, "exact", run_case(make_case(BATH, "adaptive", "exact")))
    assert max(one.overshoot for one in judged) < 0.035
    assert judged[-1].model_error_rms < 0.02


@pytest.mark.parametrize("design", ["paper", "exact"])
def test_the_daemon_accepts_the_configuration_of_each_design(design: Design) -> None:
    assert make_case(BATH, "adaptive", design).settings.rates.ticks_per_period == 2400


def test_the_volume_rises_over_five_minutes() -> None:
    sizes = [BATH.size_at(time_s) for time_s in (0.0, 5400.0, 5550.0, 5700.0, 9000.0)]
    assert sizes == pytest.approx([1.0, 1.0, 1.75, 2.5, 2.5])
