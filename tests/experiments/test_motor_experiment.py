"""The paper's motor experiment: what it claims, and what the exact design adds."""

import statistics

import pytest

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import Disturbance, run_case
from adaptdrive_sim.experiments.metrics import convergence_cycles, cycles, model_errors, rms_between
from adaptdrive_sim.experiments.outcome import NOISY, ExperimentOutcome
from adaptdrive_sim.experiments.published import MOTOR
from tests.experiments.cases import make_case, outcomes, run_all, run_all_compiled

LAST_CYCLES = (4, 7, 10)
SILENT = Disturbance(0.0)


@pytest.fixture(scope="module")
def published() -> ExperimentOutcome:
    return outcomes(MOTOR, ("fixed", "adaptive"), seeds=[0])[0]


def overshoots(outcome: ExperimentOutcome, variant: str) -> list[float]:
    judged = outcome.cycles[variant]  # type: ignore[index]
    return [judged[i].overshoot for i in LAST_CYCLES]


def test_each_disk_makes_the_fixed_controller_overshoot_more(published: ExperimentOutcome) -> None:
    one, two, three = overshoots(published, "fixed")
    assert one < 0.01
    assert 0.04 < two < 0.10
    assert 0.15 < three < 0.30


def test_the_adaptive_controller_does_not_overshoot_whatever_the_load(
    published: ExperimentOutcome,
) -> None:
    assert max(overshoots(published, "adaptive")) < 0.02


def test_the_estimates_follow_each_disk_within_two_cycles(published: ExperimentOutcome) -> None:
    assert all(found is not None and found <= 2.0 for found in published.converged)


def test_the_load_of_a_cycle_is_the_number_of_disks(published: ExperimentOutcome) -> None:
    assert [one.load for one in published.cycles["fixed"]] == [1.0] * 5 + [2.0] * 3 + [3.0] * 3


def test_the_fixed_controller_is_in_force_until_the_warm_up_is_over(
    published: ExperimentOutcome,
) -> None:
    record = published.records["adaptive"]
    assert record["adaptive"].tolist().index(True) == 90
    assert all(record["adaptive"][90:])
    assert not any(published.records["fixed"]["adaptive"])


def test_until_then_both_controllers_do_the_same(published: ExperimentOutcome) -> None:
    fixed, adaptive = published.records["fixed"], published.records["adaptive"]
    for name in ("boost_reference_V", "output"):
        assert fixed[name][:90].tolist() == adaptive[name][:90].tolist()


def test_the_reference_starts_with_its_high_half_and_the_plant_at_rest(
    published: ExperimentOutcome,
) -> None:
    record = published.records["fixed"]
    assert record["reference"][:61].tolist() == [3.2] * 60 + [3.0]
    assert record["output"][0] == pytest.approx(3.0, rel=1e-12)
    assert record["applied_V"][0] == pytest.approx(273.0, abs=0.5)


@pytest.fixture(scope="module")
def daemon() -> dict[str, Run]:
    cases = [make_case(MOTOR, name, "exact") for name in ("fixed", "adaptive")]
    return dict(zip(("fixed", "adaptive"), run_all_compiled(cases), strict=True))


@pytest.mark.slow
def test_the_exact_design_comes_closer_to_its_ideal_than_the_papers(
    daemon: dict[str, Run], published: ExperimentOutcome
) -> None:
    exact = cycles(MOTOR, "exact", daemon["adaptive"])
    for i in LAST_CYCLES:
        assert exact[i].model_error_rms < published.cycles["adaptive"][i].model_error_rms
    assert exact[LAST_CYCLES[0]].model_error_rms < 0.006
    assert exact[LAST_CYCLES[1]].model_error_rms < 0.008


@pytest.mark.slow
def test_the_exact_design_overshoots_no_more_than_the_papers_limits(
    daemon: dict[str, Run],
) -> None:
    exact = cycles(MOTOR, "exact", daemon["adaptive"])
    assert max(exact[i].overshoot for i in LAST_CYCLES) < 0.02
    found = [convergence_cycles(MOTOR, daemon["adaptive"], change) for change in MOTOR.changes]
    assert all(one is not None and one <= 2.0 for one in found)


def test_with_much_noise_the_papers_design_is_worse_adaptive_than_fixed() -> None:
    noise = Disturbance(0.02)
    fixed, adaptive = run_all(
        make_case(MOTOR, name, disturbance=noise) for name in ("fixed", "adaptive")
    )
    last_s = (1200.0, 1320.0)
    assert rms_between(adaptive, model_errors(MOTOR, "paper", adaptive), *last_s) > rms_between(
        fixed, model_errors(MOTOR, "paper", fixed), *last_s
    )


def test_without_noise_the_estimates_end_on_the_truth() -> None:
    record = run_case(make_case(MOTOR, "adaptive", disturbance=SILENT))
    for i, change_s in enumerate((600.0, 960.0, 1320.0)):
        last = round(change_s) - 1
        truth = MOTOR.truth_at(float(last))
        found = [record[name][last] for name in MOTOR.nominal().names]
        assert found == pytest.approx(truth, rel=2e-3), i


@pytest.mark.proof
def test_under_spikes_lm_rls_is_worth_a_factor_of_1_8() -> None:
    found = outcomes(MOTOR, ("adaptive", "direct_rls"), NOISY, run=run_all_compiled)
    ratios = [one.model_error("direct_rls") / one.model_error("adaptive") for one in found]
    assert statistics.median(ratios) >= 1.8


@pytest.mark.proof
def test_the_papers_claims_hold_for_every_seed() -> None:
    for outcome in outcomes(MOTOR, ("fixed", "adaptive"), run=run_all_compiled):
        one, two, three = overshoots(outcome, "fixed")
        assert one < two < three
        assert three > 0.15
        assert max(overshoots(outcome, "adaptive")) < 0.02
        assert all(found is not None and found <= 2.0 for found in outcome.converged)
