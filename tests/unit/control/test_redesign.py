"""From an estimate to gains: what is checked, what takes effect, and the way back."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control.design.noise import noise_gain
from adaptdrive.control.design.pole_placement import Plant, discrete_model
from adaptdrive.control.estimation.estimator import LambdaEstimator
from adaptdrive.control.estimation.regression import Regression
from adaptdrive.control.settings import ControllerSettings
from adaptdrive.control.supervision import redesign
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.supervision.supervisor import Verdict
from tests.integration.closed_loop.bench import AT_REST, EXACT, MOTOR, REST_V
from tests.unit.control.systems import distance

POLE = 0.7
JACKET = replace(
    EXACT.supervision, warm_up_periods=0, spread_max=0.05, confidence=2.0, residual_margin=1.5
)
LEARNING = replace(EXACT.learning, bias=True, alert=True)
CAREFUL = replace(EXACT, supervision=JACKET, learning=LEARNING)


def parameters(disks: float) -> list[float]:
    return [0.011, 11.7 * disks + 10.0, 117.0 * disks]


def motor(disks: float, settings: ControllerSettings = CAREFUL) -> Plant:
    return Plant(*discrete_model(settings, MOTOR, *MOTOR.realise(parameters(disks)), 1.0))


def theta_of(values: list[float], settings: ControllerSettings = CAREFUL) -> list[float]:
    return Regression(settings.learning, MOTOR).theta_of(*MOTOR.realise(values))


def known(disks: float = 2.0, settings: ControllerSettings = CAREFUL) -> SlowState:
    """A slow half that is sure of a motor."""
    state = SlowState(settings, MOTOR, 3.0, REST_V)
    estimator = state.estimator
    first = theta_of(parameters(disks), settings)
    estimator.estimate.theta[: len(first)] = first
    estimator.estimate.diagonal[:] = [1e-6] * len(estimator.estimate.theta)
    estimator.residuals.power, estimator.residuals.weight = 30e-6, 36.0
    estimator.periods = 100
    return state


def adapted(state: SlowState, settings: ControllerSettings = CAREFUL) -> int:
    redesign.adapt(settings, MOTOR, state, AT_REST)
    return state.supervisor.verdict


def test_an_estimate_that_is_trusted_becomes_gains_and_the_trusted_model() -> None:
    state = known()
    assert adapted(state) == Verdict.TRUSTED
    assert state.accepted
    plant, law = motor(2.0), state.law
    asked = plant.asked(POLE)
    assert law is not None
    assert law.quiet_gains == pytest.approx(plant.gains(asked), rel=1e-6)
    assert law.plant.a == pytest.approx(plant.a)
    assert law.plant.b == pytest.approx(plant.b)
    assert law.asked == pytest.approx(asked)
    assert state.values == pytest.approx(parameters(2.0))
    assert 0.0 < state.spread < 0.05
    assert state.reference_filter.asked == pytest.approx(asked)
    padded = [*asked, *[0.0] * (len(state.reference_filter.loop) - len(asked))]
    assert state.reference_filter.loop == pytest.approx(padded)


@pytest.mark.parametrize(
    ("disks", "verdict"), [(1.0, Verdict.TRUSTED), (30.0, Verdict.OUT_OF_BOUNDS)]
)
def test_parameters_out_of_bounds_are_refused(disks: float, verdict: Verdict) -> None:
    state = known(disks)
    assert adapted(state) == verdict
    assert state.accepted is (verdict == Verdict.TRUSTED)
    assert (state.law is not None) is state.accepted


def test_a_model_without_a_gain_at_rest_is_not_finite() -> None:
    state = known()
    state.estimator.estimate.theta[0], state.estimator.estimate.theta[1] = math.nan, 0.0
    assert adapted(state) == Verdict.NOT_FINITE


def test_a_load_that_swings_is_refused_before_its_certainty() -> None:
    damped = replace(CAREFUL, supervision=replace(JACKET, damping_min=0.8))
    for product, verdict in ((234.0, Verdict.TRUSTED), (900.0, Verdict.UNDERDAMPED)):
        state = known(2.0, damped)
        values = [0.011, 33.4, product]
        state.estimator.estimate.theta[:3] = theta_of(values)
        assert adapted(state, damped) == verdict
        assert math.isnan(state.spread) is (verdict == Verdict.UNDERDAMPED)


def test_an_estimate_whose_loop_is_not_sure_is_refused_after_its_residuals() -> None:
    state = known()
    state.estimator.estimate.diagonal[:] = [1e6] * len(state.estimator.estimate.theta)
    assert adapted(state) == Verdict.UNCERTAIN
    careless = replace(CAREFUL, supervision=replace(JACKET, spread_max=0.0))
    assert adapted(state, careless) == Verdict.TRUSTED
    state.supervisor.own_power, state.supervisor.fixed_power = 1.0, 0.1
    assert adapted(state) == Verdict.WORSE_THAN_FIXED


def test_a_load_that_grows_is_refused() -> None:
    wide = replace(CAREFUL, supervision=replace(JACKET, ratio_min=-1e9, ratio_max=1e9))
    wide = replace(wide, supervision=replace(wide.supervision, spread_max=0.0, residual_margin=0.0))
    state = known(2.0, wide)
    values = [0.011, -30.0, 234.0]
    state.estimator.estimate.theta[:3] = theta_of(values)
    assert adapted(state, wide) == Verdict.UNSTABLE_LOAD


@pytest.mark.parametrize(("noise", "rounding"), [(4e-3, 0.0), (0.0, 4e-3), (2e-3, 4e-3)])
def test_noise_of_the_output_makes_the_poles_slower(noise: float, rounding: float) -> None:
    """σ_u is that of the larger of noise and rounding, in the unit of the output."""
    plant = motor(2.0)
    limit = 0.5 * 4e-3 * LEARNING.output_scale * noise_gain(plant, plant.asked(POLE))
    settings = replace(CAREFUL, supervision=replace(JACKET, noise_max=limit))
    state = known(2.0, settings)
    state.estimator.detector.noise, state.estimator.sample.rounding = noise * noise, rounding
    assert adapted(state, settings) == Verdict.TRUSTED
    loop, law = state.reference_filter.loop, state.law
    assert law is not None
    noise_V = 4e-3 * LEARNING.output_scale * noise_gain(plant, loop)
    assert 0.9 * limit < noise_V <= limit
    a, b = plant.a, plant.b
    r, s = [1.0, *law.quiet_gains[: len(b) - 1]], law.quiet_gains[len(b) - 1 :]
    closed = np.convolve(a, r) + np.pad(np.convolve(b, s), (0, len(a) - len(s)))
    found, expected = np.roots(closed), np.roots(loop)
    assert distance(found, expected.tolist()) < 0.02


def learnt(state: SlowState) -> LambdaEstimator:
    assert isinstance(state.estimator, LambdaEstimator)
    return state.estimator


def lost(state: SlowState, periods: int) -> list[int]:
    """Count of the periods in which the estimate was none of a load."""
    counts = []
    for _ in range(periods):
        adapted(state)
        counts.append(learnt(state).lost_periods)
    return counts


@pytest.mark.parametrize("swings", [False, True])
def test_an_estimate_that_no_load_can_have_begins_anew_after_sixty_periods(swings: bool) -> None:
    """An incremental model that is in force goes on; one that is not begins with the estimate."""
    state = known(30.0)
    estimator, own, walking = learnt(state), learnt(state).estimate, learnt(state).incremental
    nominal, other = (
        [*theta_of(parameters(1.0)), 0.0, 0.0, 0.0],
        list(known().estimator.estimate.theta),
    )
    walking.follow(estimator.sample, own)
    estimator.sample.time_s, own.theta[5] = 500.0, 0.7
    estimator.detector.sum, walking.lead, walking.in_force = 3.0, 9.0, swings
    walking.branch.theta[:] = other
    before = list(own.theta)
    assert lost(state, 60) == list(range(1, 61))
    assert own.theta == before
    assert lost(state, 1) == [0]
    assert own.theta == pytest.approx(nominal)
    assert own.diagonal == [LEARNING.initial_covariance] * 6
    assert own.origin_s == 500.0
    assert estimator.bank.branches == [own]
    assert estimator.detector.sum == 0.0
    assert walking.lead == (9.0 if swings else 0.0)
    walking.follow(estimator.sample, own)  # nothing that would teach it another load
    assert walking.branch.theta == pytest.approx(other if swings else nominal)


def test_an_estimate_without_a_gain_at_rest_is_none_of_a_load() -> None:
    """1 + α_1 + α_2 = 0 is a pole at s = 0: there are no parameters to compare."""
    state = known()
    state.estimator.estimate.theta[0], state.estimator.estimate.theta[1] = -1.0, 0.0
    assert lost(state, 2) == [1, 2]


def test_only_periods_in_a_row_with_an_impossible_load_count() -> None:
    state = known(30.0)
    lost(state, 30)
    state.estimator.estimate.theta[:] = known(2.0).estimator.estimate.theta
    assert lost(state, 1) == [0]


def test_a_loop_that_is_asked_to_grow_is_refused() -> None:
    state = known()
    redesign.adapt(CAREFUL, MOTOR, state, replace(AT_REST, pole=1.02))
    assert state.supervisor.verdict == Verdict.UNSTABLE_LOOP
    assert not state.accepted


def test_what_an_earlier_run_has_learnt_acts_by_the_quiet_law_until_it_is_sure() -> None:
    """Before samples nothing is known of the covariance, and the fast law is not looked for."""
    loud = replace(CAREFUL, supervision=replace(JACKET, noise_max=200.0))
    state = SlowState(loud, MOTOR, 3.0, REST_V)
    assert isinstance(state.estimator, LambdaEstimator)
    state.estimator.start_from(parameters(2.0))
    state.recalled = True
    assert adapted(state, loud) == Verdict.UNCERTAIN
    assert state.law is not None
    assert state.law.fast_gains == state.law.quiet_gains
    sure = known(2.0, loud)
    adapted(sure, loud)
    assert sure.law is not None
    assert sure.law.fast_gains != sure.law.quiet_gains
