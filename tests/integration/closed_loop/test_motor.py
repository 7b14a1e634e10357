"""The paper's motor experiment, shortened: what fixed and adaptive control make of more disks."""

from dataclasses import replace
from functools import cache

import pytest

from adaptdrive.control.signals import Mode
from tests.integration.closed_loop.bench import EXACT, CYCLE_s, Trace, experiment, ideal_output

SEGMENT_s = 2 * CYCLE_s


@cache
def trace(mode: Mode, noise: float) -> Trace:
    return experiment(EXACT, mode, segment_s=SEGMENT_s, noise=noise)


def overshoots(mode: Mode, noise: float) -> list[float]:
    """With one, two and three disks, each in the last cycle."""
    found = trace(mode, noise)
    return [found.overshoot(disks * SEGMENT_s - CYCLE_s) for disks in (1, 2, 3)]


def test_under_fixed_control_the_overshoot_grows_with_the_inertia() -> None:
    one, two, three = overshoots(Mode.FIXED, 0.0)
    assert one < 0.005
    assert 0.05 < two < 0.12
    assert three > 0.15


def test_without_noise_the_exact_design_follows_its_model_and_does_not_overshoot() -> None:
    assert max(overshoots(Mode.ADAPTIVE, 0.0)) < 0.02
    found = trace(Mode.ADAPTIVE, 0.0)
    ideal = ideal_output(found)
    assert found.model_error(0, ideal) < 0.003
    assert found.model_error(CYCLE_s, ideal) < 0.003


def test_with_noise_of_two_percent_the_mean_of_many_samples_still_adapts() -> None:
    assert max(overshoots(Mode.ADAPTIVE, 0.02)) < 0.02


@pytest.mark.proof
@pytest.mark.parametrize("noise", [0.02, 0.0])
def test_the_check_against_uncertainty_does_not_stand_in_the_way_of_a_change(noise: float) -> None:
    learning = replace(EXACT.learning, bias=True, alert=True)
    found = []
    for confidence in (0.0, 2.0):
        supervision = replace(
            EXACT.supervision, spread_max=0.05, dwell_periods=3, confidence=confidence
        )
        settings = replace(EXACT, learning=learning, supervision=supervision)
        found.append(
            experiment(settings, Mode.ADAPTIVE, segment_s=SEGMENT_s, disks=(1, 3, 1), noise=noise)
        )
    assert found[0].output == found[1].output
