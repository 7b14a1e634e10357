"""The paper's motor experiment: what it claims, and what the exact design adds."""

import statistics

import pytest

from adaptdrive_sim.experiments.case import (
    Variant,
    cycles,
    model_errors,
    rms_between,
    run_case,
)
from adaptdrive_sim.experiments.experiment import MOTOR
from adaptdrive_sim.experiments.outcome import Outcome
from adaptdrive_sim.experiments.reproduce import NOISY
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import (
    SEEDS,
    SHORT_LAST_CYCLES,
    SHORT_MOTOR,
    make_case,
    outcome,
)

LAST_CYCLES = (4, 7, 10)
SILENT = NoiseParameters(0.0)


@pytest.fixture(scope="module")
def short() -> Outcome:
    return outcome(SHORT_MOTOR, ("fixed", "adaptive"))


def overshoots(
    found: Outcome, variant: Variant, last: tuple[int, ...] = SHORT_LAST_CYCLES
) -> list[float]:
    return [found.cycles[variant][i].overshoot for i in last]


def test_each_disk_makes_the_fixed_controller_overshoot_more(short: Outcome) -> None:
    one, two, three = overshoots(short, "fixed")
    assert one < 0.01
    assert 0.04 < two < 0.10
    assert 0.15 < three < 0.30


def test_the_adaptive_controller_does_not_overshoot_whatever_the_load(
    short: Outcome,
) -> None:
    assert max(overshoots(short, "adaptive")) < 0.02


def test_the_estimates_follow_each_disk_within_two_cycles(short: Outcome) -> None:
    assert all(found is not None and found <= 2.0 for found in short.converged)


def test_the_fixed_controller_is_in_force_until_the_warm_up_is_over(
    short: Outcome,
) -> None:
    record = short.records["adaptive"]
    assert record["adaptive"].tolist().index(True) == 90
    assert all(record["adaptive"][90:])
    assert not any(short.records["fixed"]["adaptive"])


def test_until_then_both_controllers_do_the_same(short: Outcome) -> None:
    fixed, adaptive = short.records["fixed"], short.records["adaptive"]
    for name in ("boost_reference_V", "output"):
        assert fixed[name][:90].tolist() == adaptive[name][:90].tolist()


def test_the_reference_starts_with_its_high_half_and_the_plant_at_rest(
    short: Outcome,
) -> None:
    record = short.records["fixed"]
    assert record["reference"][:61].tolist() == [3.2] * 60 + [3.0]
    assert record["output"][0] == pytest.approx(3.0, rel=1e-12)
    assert record["applied_V"][0] == pytest.approx(273.0, abs=0.5)


@pytest.mark.proof
def test_without_noise_the_estimates_end_on_the_truth() -> None:
    record = run_case(make_case(MOTOR, "adaptive", disturbance=SILENT))
    for i, change_s in enumerate((600.0, 960.0, 1320.0)):
        last = round(change_s) - 1
        truth = MOTOR.truth_at(float(last))
        found = [record[name][last] for name in MOTOR.nominal().names]
        assert found == pytest.approx(truth, rel=2e-3), i


@pytest.mark.proof
def test_with_much_noise_the_papers_design_is_worse_adaptive_than_fixed() -> None:
    found = outcome(MOTOR, ("fixed", "adaptive"), NoiseParameters(0.02))
    fixed, adaptive = (
        rms_between(one, model_errors(MOTOR, "paper", one), 1200.0, 1320.0)
        for one in (found.records["fixed"], found.records["adaptive"])
    )
    assert adaptive > fixed


@pytest.mark.proof
def test_under_spikes_lm_rls_is_worth_a_factor_of_1_8() -> None:
    variants: tuple[Variant, ...] = "adaptive", "direct_rls"
    found = [outcome(MOTOR, variants, NOISY, seed) for seed in SEEDS]
    ratios = [one.model_error("direct_rls") / one.model_error("adaptive") for one in found]
    assert statistics.median(ratios) >= 1.8


@pytest.mark.proof
@pytest.mark.parametrize("seed", SEEDS)
def test_the_papers_claims_hold_for_every_seed(seed: int) -> None:
    found = outcome(MOTOR, ("fixed", "adaptive"), seed=seed)
    one, two, three = overshoots(found, "fixed", LAST_CYCLES)
    assert one < two < three
    assert three > 0.15
    assert max(overshoots(found, "adaptive", LAST_CYCLES)) < 0.02
    assert all(one is not None and one <= 2.0 for one in found.converged)
    if seed == 0:
        exact = run_case(make_case(MOTOR, "adaptive", "exact"))
        judged = cycles(MOTOR, "exact", exact)
        for i, most in zip(LAST_CYCLES, (0.006, 0.008, 1.0), strict=True):
            paper = found.cycles["adaptive"][i].model_error_rms
            assert judged[i].model_error_rms < min(most, paper)
            assert judged[i].overshoot < 0.02
