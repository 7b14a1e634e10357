"""The paper's motor experiment, shortened: what fixed and adaptive control make of more disks."""

from dataclasses import replace
from functools import cache

import pytest

from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.signals import Mode
from tests.closed_loop.bench import EXACT, PAPER, Bench, CYCLE_s, Trace, experiment, ideal_output
from tests.support import sample

SEGMENT_s = 2 * CYCLE_s
DESIGNS = pytest.mark.parametrize("settings", sample([EXACT, PAPER], 1), ids=["exact", "paper"])


@cache
def trace(settings: ControllerSettings, mode: Mode, noise: float) -> Trace:
    return experiment(settings, mode, segment_s=SEGMENT_s, noise=noise)


def last_overshoot(found: Trace, disks: int) -> float:
    return found.overshoot(disks * SEGMENT_s - CYCLE_s)


@DESIGNS
def test_under_fixed_control_the_overshoot_grows_with_the_inertia(
    settings: ControllerSettings,
) -> None:
    found = trace(settings, Mode.FIXED, 0.0)
    one, two, three = (last_overshoot(found, disks) for disks in (1, 2, 3))
    assert one < 0.005
    assert 0.05 < two < 0.12
    assert three > 0.15


@DESIGNS
@pytest.mark.parametrize("noise", sample([0.0, 0.002], 1))
def test_under_adaptive_control_it_does_not(settings: ControllerSettings, noise: float) -> None:
    found = trace(settings, Mode.ADAPTIVE, noise)
    assert max(last_overshoot(found, disks) for disks in (1, 2, 3)) < 0.02


def test_without_noise_the_exact_design_follows_its_model() -> None:
    found = trace(EXACT, Mode.ADAPTIVE, 0.0)
    ideal = ideal_output(found, exact=True)
    assert found.model_error(0, ideal) < 0.003
    assert found.model_error(CYCLE_s, ideal) < 0.003


@pytest.mark.proof
def test_the_paper_design_misses_its_model_because_the_input_is_held() -> None:
    found = trace(PAPER, Mode.FIXED, 0.0)
    ideal = ideal_output(found, exact=False)
    assert 0.003 < found.model_error(CYCLE_s, ideal) < 0.02


@pytest.mark.proof
def test_after_a_change_the_estimates_converge_within_a_cycle() -> None:
    settled: list[bool] = []

    def watch(bench: Bench) -> None:
        tau = 11.7 * bench.motor.disks
        truth = {"gain": 0.011, "tau_sum_s": tau + 10.0, "tau_product_s2": 10.0 * tau}
        found = bench.decisions[-1].estimates
        settled.append(all(abs(found[name].value / truth[name] - 1.0) < 0.05 for name in truth))

    experiment(PAPER, Mode.ADAPTIVE, segment_s=2 * CYCLE_s, disks=(1, 2, 3), watch=watch)
    for change in (2 * CYCLE_s, 4 * CYCLE_s):
        assert not settled[change + 5]
        assert all(settled[change + CYCLE_s : change + 2 * CYCLE_s - 1])


def test_with_noise_of_two_percent_the_mean_of_many_samples_still_adapts() -> None:
    found = trace(EXACT, Mode.ADAPTIVE, 0.02)
    assert max(last_overshoot(found, disks) for disks in (1, 2, 3)) < 0.02


@pytest.mark.proof
@pytest.mark.parametrize("noise", [0.02, 0.0])
def test_the_check_against_uncertainty_does_not_stand_in_the_way_of_a_change(noise: float) -> None:
    learning = replace(EXACT.learning, bias=True, alert=True)
    found = []
    for confidence in (0.0, 2.0):
        jacket = replace(EXACT.jacket, spread_max=0.05, dwell_periods=3, confidence=confidence)
        settings = replace(EXACT, learning=learning, jacket=jacket)
        found.append(
            experiment(settings, Mode.ADAPTIVE, segment_s=2 * CYCLE_s, disks=(1, 3, 1), noise=noise)
        )
    assert found[0].output == found[1].output
