"""Other settings of the estimator: what it hears, and what becomes of it."""

import dataclasses

import numpy as np
import pytest

from adaptdrive_sim.course import Run
from adaptdrive_sim.experiments.case import Disturbance, run_case
from adaptdrive_sim.experiments.experiment import SweepSettings
from adaptdrive_sim.experiments.published import BATH, MOTOR
from adaptdrive_sim.experiments.sweep import (
    Heard,
    Setting,
    _estimate_directly,
    _estimate_filtered,
    listen,
    settings_over_forgetting,
    settling_time_s,
    try_settings,
)
from tests.experiments.cases import make_case

SILENT = Disturbance(0.0)
MINUTE = dataclasses.replace(MOTOR, duration_s=240.0, changes=())


def heard_by(variant: str) -> tuple[Heard, Run]:
    case = make_case(MINUTE, variant, disturbance=SILENT)  # type: ignore[arg-type]
    record = run_case(case, keep_ticks=True)
    return listen(case, record), record


def test_estimates_from_the_recorded_ticks_are_those_of_the_controller() -> None:
    heard, estimates = heard_by("fixed")
    (found,) = _estimate_filtered(heard, heard.case.settings.learning, [])
    expected = np.column_stack([estimates[name] for name in MOTOR.nominal().names])
    assert np.allclose(found[5:], expected[5:], rtol=1e-5)


def test_that_is_so_for_direct_least_squares_too() -> None:
    bath = dataclasses.replace(BATH, duration_s=600.0, changes=())
    case = make_case(bath, "fixed", disturbance=SILENT)
    record = run_case(case, keep_ticks=True)
    (found,) = _estimate_directly(listen(case, record), case.settings.learning, [])
    expected = np.column_stack([record[name] for name in BATH.nominal().names])
    assert np.allclose(found[5:], expected[5:], rtol=1e-6)


def test_a_first_order_load_settles_after_four_time_constants() -> None:
    load = BATH.nominal()
    tau_s = 1.0 / load.denominator[1]
    assert settling_time_s(load, 0.1) == pytest.approx(np.log(50.0) * tau_s, abs=0.2)


def test_the_papers_values_are_among_those_tried() -> None:
    for experiment in (MOTOR, BATH):
        assert experiment.paper.forgetting in experiment.sweep.forgetting
        assert experiment.paper.tau_lambda_s in experiment.sweep.tau_lambda_s


def test_every_method_is_tried_with_every_forgetting_factor() -> None:
    few = dataclasses.replace(MOTOR, sweep=SweepSettings((0.9, 0.99), (5.0,), ("rls", "lm-rls")))
    assert settings_over_forgetting(few) == [
        Setting("rls", 0.9, 10.0),
        Setting("rls", 0.99, 10.0),
        Setting("lm-rls", 0.9, 10.0),
        Setting("lm-rls", 0.99, 10.0),
    ]


@pytest.mark.proof
def test_forgetting_and_filtering_trade_speed_for_noise() -> None:
    case = make_case(MOTOR, "fixed")
    heard = listen(case, run_case(case, keep_ticks=True))
    quick, published, slow, sluggish = try_settings(
        heard,
        [
            Setting("lm-rls", 0.90, 10.0),
            Setting("lm-rls", 0.97, 10.0),
            Setting("lm-rls", 0.995, 10.0),
            Setting("lm-rls", 0.97, 200.0),
        ],
    )
    assert quick.cycles is not None
    assert published.cycles is not None
    assert slow.cycles is not None
    assert quick.cycles < published.cycles < slow.cycles
    assert quick.deviation > published.deviation > slow.deviation
    assert sluggish.cycles is None
    assert sluggish.deviation > published.deviation
