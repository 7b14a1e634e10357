"""Other settings of the estimator: its input, and what becomes of it."""

import dataclasses

import numpy as np
import pytest

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import run_case
from adaptdrive_sim.experiments.experiment import MOTOR
from adaptdrive_sim.experiments.outcome import (
    Recording,
    _estimate_filtered,
    recording_of,
    setting,
    try_settings,
)
from adaptdrive_sim.world import NoiseParameters
from tests.unit.simulators.experiments.cases import make_case

SILENT = NoiseParameters(0.0)
MINUTE = dataclasses.replace(MOTOR, duration_s=240.0, changes=())


def recorded(variant: str) -> tuple[Recording, Run]:
    case = make_case(MINUTE, variant, disturbance=SILENT)  # type: ignore[arg-type]
    record = run_case(case, keep_ticks=True)
    return recording_of(case, record), record


def test_estimates_from_the_recorded_ticks_are_those_of_the_controller() -> None:
    given, estimates = recorded("fixed")
    (found,) = _estimate_filtered(given, given.case.settings.learning, [given.output])
    expected = np.column_stack([estimates[name] for name in MOTOR.nominal().names])
    assert np.allclose(found[5:], expected[5:], rtol=1e-5)


@pytest.mark.proof
def test_forgetting_and_filtering_trade_speed_for_noise() -> None:
    case = make_case(MOTOR, "fixed")
    given = recording_of(case, run_case(case, keep_ticks=True))
    quick, published, slow, sluggish = try_settings(
        given,
        [
            setting(case, "lm-rls", 0.90, 10.0),
            setting(case, "lm-rls", 0.97, 10.0),
            setting(case, "lm-rls", 0.995, 10.0),
            setting(case, "lm-rls", 0.97, 200.0),
        ],
    )
    assert quick.cycles is not None
    assert published.cycles is not None
    assert slow.cycles is not None
    assert quick.cycles < published.cycles < slow.cycles
    assert quick.deviation > published.deviation > slow.deviation
    assert sluggish.cycles is None
    assert sluggish.deviation > published.deviation
