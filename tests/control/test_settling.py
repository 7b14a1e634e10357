"""How a comparison of explanations ends, and what an alarm begins: states made by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control import challenger as chal
from adaptdrive.control import regression as reg
from adaptdrive.control import rivals as riv
from adaptdrive.control.branch import Branch, Datum, predict
from adaptdrive.control.estimator import EstimatorState
from adaptdrive.control.evidence import WINDOW
from adaptdrive.control.explanation import learn_and_explain
from adaptdrive.control.hypotheses import BOTH, DISTURBANCE, LOAD, NOTHING
from tests.closed_loop.bench import MOTOR
from tests.control.test_explanation import LEARNING, settled

POWER = 1e-6
"""σ² of the detector, and σ0² of the comparison."""

SIGMA = 1e-3
"""σ of both."""

CALM = 0.97
"""One sample without an error takes 3 % off σ²."""

MARK = 3
"""A coefficient of the initial state, whose function is 0 after 10,000 s: it tells θ apart."""


def sure_branch(branch: Branch, state: EstimatorState, mark: float, squares: float) -> None:
    branch.theta[:] = state.estimate.theta
    branch.theta[MARK] = mark
    branch.upper[:] = state.estimate.upper
    branch.diagonal[:] = [1e-9] * len(state.estimate.diagonal)
    branch.squares, branch.logs = squares, 0.0


def compared(winner: int, squares: float = 20.0, others: float = 2000.0) -> EstimatorState:
    """A comparison of WINDOW samples in which one explanation has predicted best."""
    state = settled()
    state.sample.time_s, state.periods, state.idle_periods, state.innovation = 1e4, 5000, 7, 0.0
    state.surprise.power, state.surprise.samples = POWER, 100
    state.estimate.diagonal[:] = [1e-9] * len(state.estimate.diagonal)
    for kind in range(NOTHING, BOTH + 1):
        sums = squares if kind == winner else others
        sure_branch(state.rivals.branches[kind], state, 0.1 * (kind + 1), sums * POWER)
    state.rivals.samples, state.rivals.anchor.power = WINDOW, POWER
    return state


def expected_sample(state: EstimatorState) -> float:
    return float(np.dot(state.estimate.theta, state.sample.regressor))


def take(state: EstimatorState, error: float = 0.0) -> None:
    """Learn a sample that each estimate has expected within an error, by default exactly."""
    state.sample.target = expected_sample(state)
    predict(state.estimate, state.sample)
    state.sample.target += error
    learn_and_explain(state, LEARNING, MOTOR)


def posterior(squares: float) -> float:
    """Mean of the squares and of four of the prior."""
    return (4.0 + squares) * POWER / (4.0 + WINDOW + 1.0)


@pytest.mark.parametrize("winner", [NOTHING, DISTURBANCE, LOAD, BOTH])
def test_what_has_won_is_the_estimate_and_ends_the_comparison(winner: int) -> None:
    state = compared(winner)
    weight = state.residual_weight
    take(state)
    best = state.rivals.branches[winner]
    assert (state.rivals.kind, state.rivals.samples) == (winner, 0)
    assert state.estimate.theta == best.theta
    assert state.estimate.theta[MARK] == 0.1 * (winner + 1)
    assert (state.estimate.upper, state.estimate.diagonal) == (best.upper, best.diagonal)
    assert state.idle_periods == 0
    assert state.residual_weight == LEARNING.forgetting * weight + 1.0
    assert state.residual_power == state.surprise.power * state.residual_weight


@pytest.mark.parametrize(
    ("winner", "squares", "power"),
    [
        (LOAD, 20.0, posterior(20.0)),
        (BOTH, 20.0, posterior(20.0)),
        (LOAD, 200.0, posterior(200.0)),
        (DISTURBANCE, 20.0, CALM * POWER),
        (NOTHING, 20.0, posterior(20.0)),
        (NOTHING, 200.0, 4.0 * CALM * POWER),
    ],
)
def test_the_variance_after_it_is_that_of_the_winner(
    winner: int, squares: float, power: float
) -> None:
    """A load brings its own; what nothing explains raises it by a factor of 4 at most."""
    state = compared(winner, squares, 1e5)
    take(state)
    assert state.rivals.samples == 0
    assert state.surprise.power == pytest.approx(power, rel=1e-9)


@pytest.mark.parametrize(("winner", "judged"), [(DISTURBANCE, 13), (LOAD, 0), (BOTH, 0)])
def test_a_challenger_is_judged_anew_after_a_load(winner: int, judged: int) -> None:
    state = compared(winner)
    sure_branch(state.challenger.branch, state, 0.9, 0.0)
    state.challenger.samples, state.challenger.judged, state.challenger.power = 30, 12, POWER
    take(state)
    # the sample itself is judged after the comparison has ended
    assert state.challenger.judged == (judged or 1)


@pytest.mark.parametrize(
    ("winner", "others", "alarms"),
    [(NOTHING, 20.0, True), (NOTHING, 2000.0, True), (LOAD, 2000.0, True), (LOAD, 70.0, False)],
)
def test_the_next_change_is_noticed_beside_nothing_or_a_clear_explanation(
    winner: int, others: float, alarms: bool
) -> None:
    state = compared(winner, 20.0, others)
    assert state.alarm_period != state.periods
    state.surprise.sum = 1e3
    take(state, 4.0 * SIGMA)
    assert (state.alarm_period == state.periods) is alarms


@pytest.mark.parametrize(("others", "alarms"), [(20.0, False), (70.0, True)])
def test_what_a_load_in_the_running_expected_is_no_other_change(
    others: float, *, alarms: bool
) -> None:
    state = compared(NOTHING, 20.0, others)
    state.rivals.samples, state.surprise.sum = WINDOW // 2, 1e3
    state.rivals.branches[LOAD].theta[-1] += 4.0 * SIGMA
    take(state, 4.0 * SIGMA)
    assert (state.alarm_period == state.periods) is alarms
    assert state.surprise.power == pytest.approx(1.03 * POWER, rel=1e-9)
    assert (state.rivals.samples > WINDOW // 2) is not alarms


@pytest.mark.parametrize(("since", "louder"), [(WINDOW - 1, 4.0), (WINDOW, 1.0)])
def test_an_alarm_soon_after_another_is_noise_of_its_own(since: int, louder: float) -> None:
    state = compared(NOTHING)
    state.rivals.samples = 0
    state.alarm_period = state.periods - since
    state.surprise.sum = 1e3
    take(state)
    assert state.alarm_period == state.periods
    assert state.surprise.power == pytest.approx(louder * CALM * POWER, rel=1e-9)


@pytest.mark.parametrize(
    ("waiting", "after"), [(0, 1), (riv.ROOM - 2, riv.ROOM - 1), (riv.ROOM - 1, 0)]
)
def test_suspicious_samples_wait_while_there_is_room_for_the_one_that_gives_the_alarm(
    waiting: int, after: int
) -> None:
    state = compared(NOTHING)
    state.rivals.samples, state.rivals.waiting = 0, waiting
    state.surprise.sum = 8.0
    take(state)
    assert state.rivals.waiting == after


def test_an_alarm_begins_a_challenger_that_has_learnt_the_waiting_samples_once() -> None:
    state = compared(NOTHING)
    state.rivals.samples = 0
    before = replace(state.sample, time_s=state.sample.time_s - 3.0)
    riv.drop_anchor(state.rivals, state.estimate, before)
    for second in (2.0, 1.0):
        time_s = state.sample.time_s - second
        sample = Datum(state.sample.regressor, expected_sample(state), time_s)
        riv.keep_sample(state.rivals, sample, riv.ROOM)
    state.surprise.sum = 1e3
    take(state)
    assert state.rivals.samples == 3
    assert state.challenger.samples == 3


def ahead(state: EstimatorState) -> None:
    """Give the state a challenger that has predicted far better."""
    sure_branch(state.challenger.branch, state, 0.9, 1.0 * POWER)
    challenger = state.challenger
    challenger.samples, challenger.judged, challenger.power = 60, 50, POWER
    state.estimate.squares, state.estimate.logs = 1e4 * POWER, 0.0


def test_a_challenger_that_has_won_is_the_estimate() -> None:
    state = compared(DISTURBANCE)
    state.rivals.samples = 0
    ahead(state)
    assert chal.lead(state.challenger, state.estimate) > 27.0
    take(state)
    assert state.estimate.theta == state.challenger.branch.theta
    assert state.estimate.theta[MARK] == 0.9
    calm = state.rivals.calm
    assert (calm.theta, calm.upper, calm.diagonal) == (
        state.estimate.theta,
        state.estimate.upper,
        state.estimate.diagonal,
    )
    assert (state.rivals.kind, state.rivals.samples) == (BOTH, 0)
    assert state.rivals.loads == pytest.approx(1.0, rel=0.01)
    assert (state.challenger.samples, state.surprise.alarms, state.surprise.sum) == (0, 1, 0.0)
    assert state.surprise.power == pytest.approx((4.0 + 1.0) * POWER / (4.0 + 51.0), rel=1e-9)
    assert state.residual_power == state.surprise.power * state.residual_weight


def test_a_challenger_that_wins_ends_a_suspicion_with_it() -> None:
    """What looked like the next change was expected by the new estimate."""
    state = compared(DISTURBANCE)
    state.rivals.samples, state.surprise.sum = 0, 8.0
    ahead(state)
    take(state)
    assert state.estimate.theta[MARK] == 0.9
    assert (state.surprise.sum, state.rivals.waiting) == (0.0, 0)


@pytest.mark.parametrize("error", [0.0, 2.0 * SIGMA, -0.5 * SIGMA])
def test_the_error_of_an_explanation_is_shown_in_the_unit_of_the_output(error: float) -> None:
    state = compared(DISTURBANCE)
    state.rivals.samples = 5
    take(state, error)
    assert state.rivals.samples == 6
    assert state.innovation == pytest.approx(error * LEARNING.output_scale, abs=1e-12)


@pytest.mark.parametrize(("expected", "samples"), [(True, 31), (False, 1)])
def test_a_challenger_that_expected_what_surprised_goes_on(expected: bool, samples: int) -> None:
    """An alarm that is new to it too begins it anew."""
    state, error = compared(NOTHING), 20.0 * SIGMA
    state.rivals.samples, state.surprise.sum = 0, 1e3
    sure_branch(state.challenger.branch, state, 0.9, 0.0)
    state.challenger.samples, state.challenger.power = 30, POWER
    state.challenger.branch.theta[-1] += error if expected else 0.0
    take(state, error)
    assert state.alarm_period == state.periods
    assert state.challenger.samples == samples


def test_a_challenger_waits_while_a_load_is_compared() -> None:
    state = compared(LOAD)
    state.rivals.samples = 5
    ahead(state)
    take(state)
    assert state.rivals.samples == 6
    assert state.estimate.theta[MARK] == 0.1 * (LOAD + 1)
    assert state.challenger.samples == 61


def test_the_regressor_stays_that_of_the_estimate_beside_a_challenger() -> None:
    """The functions of the initial state are counted from the origin of each."""
    state = compared(NOTHING)
    state.rivals.samples, state.estimate.origin_s = 0, state.sample.time_s - 10.0
    sure_branch(state.challenger.branch, state, 0.0, 0.0)
    state.challenger.branch.origin_s = state.sample.time_s - 25.0
    state.challenger.samples, state.challenger.power = 5, POWER
    reg.fill_initial_state(state.sample.regressor, LEARNING, MOTOR, 10.0)
    take(state)
    assert state.challenger.samples == 6
    ratio = 10.0 / LEARNING.tau_lambda_s
    expected = [math.exp(-ratio), ratio * math.exp(-ratio)]
    assert state.sample.regressor[MARK : MARK + 2] == pytest.approx(expected, rel=1e-12)
