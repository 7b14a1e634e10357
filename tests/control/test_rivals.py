"""Rival explanations and the challenger: likelihoods against Student's t, and decisions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t as student

from adaptdrive.control import challenger as chal
from adaptdrive.control import rivals as riv
from adaptdrive.control import rls
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.branch import Branch, Datum, copy_estimate, new_branch, posterior_power
from adaptdrive.control.hypotheses import (
    ANEW,
    BOTH,
    DISTURBANCE,
    LOAD,
    NOTHING,
    restart_past,
    widen,
)
from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.regression import theta_of
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LEARNING = replace(SCALED_LEARNING, forgetting=1.0, bias=True, alert=True, initial_state=True)
FORGETTING = replace(LEARNING, forgetting=0.97)
TAU_S, COUNT, FIRST = 10.0, 6, 3
POWER = 4e-6
WEIGHT = 4.0
"""Samples that σ0² counts for."""


def theta(disks: float = 2.0) -> list[float]:
    """θ of the motor, with an offset of the input."""
    product = 117.0 * disks
    model = [0.0, 0.0, 0.011 / product], [1.0, (11.7 * disks + 10.0) / product, 1.0 / product]
    values = theta_of(LEARNING, MOTOR, *model)
    return [*values, 0.01, -0.02, 0.05]


def regressor(random: np.random.Generator) -> list[float]:
    first, second, u = random.uniform(0.8, 1.1, 3).tolist()
    return [-first, -second, u, 0.0, 0.0, 1.0]


@dataclass
class Case:
    """An anchor with some samples after it."""

    rivals: riv.Rivals
    regressors: list[list[float]]
    targets: list[float]
    times_s: list[float]


def case(count: int = 5, seed: int = 1, noise: float = 0.004) -> Case:
    random = np.random.default_rng(seed)
    rivals = riv.new_rivals(COUNT)
    now = new_branch(COUNT)
    rls.reset(now.theta, now.upper, now.diagonal, 3.0)
    now.theta[:] = theta()
    now.origin_s = 2.0
    rivals.lowered[:] = regressor(random)
    riv.drop_anchor(rivals, now, Datum(regressor(random), time_s=30.0))
    found = Case(rivals, [], [], [])
    for number in range(count):
        r, time_s = regressor(random), 31.0 + number
        target = float(np.dot(r, theta(2.6)) + noise * random.normal())
        assert riv.keep_sample(rivals, Datum(r, target, time_s), riv.ROOM)
        found.regressors.append(r)
        found.targets.append(target)
        found.times_s.append(time_s)
    return found


def filled(r: list[float], since_s: float) -> Array:
    """A regressor with the functions of the initial state."""
    h = since_s / TAU_S
    return np.array([*r[:FIRST], math.exp(-h), h * math.exp(-h), r[-1]])


def start(kind: int, one: Case) -> Branch:
    """What an explanation starts from."""
    branch = new_branch(COUNT)
    copy_estimate(branch, one.rivals.calm)
    one.rivals.anchor.power, one.rivals.anchor.gap_s = POWER, 1.0
    if kind != NOTHING:
        restart_past(branch, LEARNING, MOTOR, 30.0)
        widen(branch, kind, LEARNING, MOTOR, one.rivals.anchor)
    return branch


@dataclass
class Bayes:
    """Bayesian linear regression, σ² known as σ0² from ν0 samples, one sample after the other."""

    mean: Array
    covariance: Array
    squares: float = 0.0
    samples: int = 0
    log_density: float = 0.0

    def take(self, r: Array, target: float) -> None:
        freedom = WEIGHT + self.samples
        variance = (WEIGHT * POWER + self.squares) / freedom
        share = 1.0 + float(r @ self.covariance @ r)
        error = target - float(r @ self.mean)
        self.log_density += float(student.logpdf(error, freedom, scale=math.sqrt(variance * share)))
        self.squares += error * error / share
        gain = self.covariance @ r / share
        self.mean = self.mean + gain * error
        self.covariance = self.covariance - np.outer(gain, r @ self.covariance)
        self.samples += 1


def bayes(kind: int, one: Case) -> Bayes:
    branch = start(kind, one)
    covariance = np.array(ud.covariance(branch.upper, branch.diagonal)).reshape(COUNT, COUNT)
    found = Bayes(np.array(branch.theta), covariance)
    for r, target, time_s in zip(one.regressors, one.targets, one.times_s, strict=True):
        found.take(filled(r, time_s - branch.origin_s), target)
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("loads", [0.0, 1.5])
def test_explanations_are_compared_by_their_likelihood_and_rarity(seed: int, loads: float) -> None:
    one = case(seed=seed)
    expected = {kind: bayes(kind, one) for kind in range(NOTHING, BOTH + 1)}
    one.rivals.loads, one.rivals.samples = loads, 7
    riv.split(one.rivals, LEARNING, MOTOR, POWER)
    rarity = {NOTHING: 0.0, DISTURBANCE: 0.0, LOAD: 9.0 + 9.0 * loads, BOTH: 18.0 + 9.0 * loads}
    scores = {kind: expected[kind].log_density - rarity[kind] for kind in expected}
    for kind in (DISTURBANCE, LOAD, BOTH):
        branch = one.rivals.branches[kind]
        lead = branch.score - one.rivals.branches[NOTHING].score
        assert lead == pytest.approx(scores[kind] - scores[NOTHING], rel=1e-6, abs=1e-6)
        assert branch.theta == pytest.approx(expected[kind].mean, abs=1e-6)
        assert branch.squares == pytest.approx(expected[kind].squares, rel=1e-6)
    assert one.rivals.kind == max(scores, key=lambda kind: scores[kind])
    assert one.rivals.samples == 5
    assert one.rivals.waiting == 0


def test_an_explanation_forgets_along_its_samples() -> None:
    learning, one = FORGETTING, case(3)
    branch = start(LOAD, one)
    for r, target, time_s in zip(one.regressors, one.targets, one.times_s, strict=True):
        sample = filled(r, time_s - 30.0).tolist()
        rls.update_along(branch.theta, branch.upper, branch.diagonal, sample, target, 0.97)
    riv.split(one.rivals, learning, MOTOR, POWER)
    found = one.rivals.branches[LOAD]
    assert found.theta == pytest.approx(branch.theta)
    assert ud.covariance(found.upper, found.diagonal) == pytest.approx(
        ud.covariance(branch.upper, branch.diagonal)
    )


def test_the_sample_is_left_as_the_likeliest_explanation_sees_it() -> None:
    one = case()
    riv.split(one.rivals, LEARNING, MOTOR, POWER)
    r = list(one.regressors[0])
    riv.follow(one.rivals, LEARNING, MOTOR, Datum(r, one.targets[0], 40.0))
    origin_s = 2.0 if one.rivals.kind == NOTHING else 30.0
    assert r == pytest.approx(filled(r, 40.0 - origin_s))
    assert one.rivals.samples == 6


def test_an_anchor_is_the_last_calm_sample_and_the_gap_ends_at_the_next() -> None:
    one = case()
    assert one.rivals.waiting == 5
    assert one.rivals.calm.origin_s == 2.0
    assert one.rivals.calm.theta == theta()
    assert one.rivals.anchor.time_s == 30.0
    assert one.rivals.anchor.lowered == one.rivals.lowered
    riv.prepare(one.rivals, 7e-6)
    assert one.rivals.anchor.power == 7e-6
    assert one.rivals.anchor.gap_s == 1.0
    riv.drop_anchor(one.rivals, one.rivals.calm, Datum(one.regressors[2], time_s=33.0))
    assert one.rivals.waiting == 0
    assert one.rivals.anchor.regressor == one.regressors[2]


def test_no_more_samples_are_kept_than_there_is_room_for() -> None:
    rivals = riv.new_rivals(COUNT)
    samples = [Datum([float(k)] * COUNT, 10.0 * k, 0.5 * k) for k in range(5)]
    kept = [riv.keep_sample(rivals, one, 3) for one in samples]
    assert kept == [True, True, True, False, False]
    assert rivals.kept[:3] == samples[:3]
    assert rivals.kept[0] is not samples[0]
    full = [riv.keep_sample(rivals, samples[0], riv.ROOM) for _ in range(20)]
    assert sum(full) == 11 - 3


def compared(
    samples: int, *, nothing: float = 0.0, disturbance: float = -50.0, load: float = -50.0,
    both: float = -50.0,
) -> riv.Rivals:  # fmt: skip
    """A comparison with given scores; every load can exist."""
    rivals = riv.new_rivals(COUNT)
    for kind, score in enumerate((nothing, disturbance, load, both)):
        branch = rivals.branches[kind]
        branch.theta[:] = theta()
        branch.score = score
    rivals.samples = samples
    return rivals


@pytest.mark.parametrize("best", range(4))
@pytest.mark.parametrize("rival", range(4))
@pytest.mark.parametrize(("distance", "clear"), [(9.9, False), (10.1, True)])
def test_an_explanation_is_clear_when_it_has_left_each_other_behind(
    best: int, rival: int, distance: float, *, clear: bool
) -> None:
    """By odds of e^10."""
    rivals = compared(6)
    for kind in range(4):
        rivals.branches[kind].score = -distance if kind == rival else -50.0
    rivals.branches[best].score = 0.0
    assert riv.is_clear(rivals) is (clear or best == rival)


def decision(rivals: riv.Rivals) -> int | None:
    """The explanation that a comparison ends with, None while it goes on."""
    rivals.kind = 99
    settled = riv.is_settled(rivals, LEARNING, MOTOR)
    assert settled is (rivals.kind != 99)
    return rivals.kind if settled else None


@pytest.mark.parametrize(
    ("load", "error", "expected"),
    [(-10.0, 1.7, True), (-10.0, -1.8, False), (-10.1, 0.0, False), (3.0, 1.7, True)],
)
def test_a_sample_is_expected_where_one_that_is_not_left_behind_has_z2_below_three(
    load: float, error: float, expected: bool
) -> None:
    rivals = compared(6, load=load)
    rivals.anchor.power = POWER
    for kind in range(NOTHING, BOTH + 1):
        branch = rivals.branches[kind]
        branch.excitation, branch.innovation = 0.2, 9.0 * math.sqrt(POWER)
    rivals.branches[DISTURBANCE].innovation = 0.0
    rivals.branches[LOAD].innovation = error * math.sqrt(1.2 * POWER)
    assert riv.is_expected(rivals, LEARNING) is expected


@pytest.mark.parametrize("kind", [DISTURBANCE, LOAD, BOTH])
def test_each_explanation_that_is_clearly_ahead_ends_the_comparison_after_ten_samples(
    kind: int,
) -> None:
    names = {DISTURBANCE: "disturbance", LOAD: "load", BOTH: "both"}
    for samples, lead, expected in ((9, 10.1, None), (10, 10.1, kind), (10, 10.0, None)):
        rivals = compared(samples, **{names[kind]: lead})
        assert decision(rivals) == expected
        assert riv.is_clear(rivals) is (lead > 10.0)


def test_nothing_that_is_clearly_ahead_ends_it_too() -> None:
    assert decision(compared(10, nothing=70.0)) == NOTHING
    assert riv.is_clear(compared(10, nothing=0.0))


def test_a_comparison_with_two_close_ones_goes_on_for_twenty_samples() -> None:
    for samples, expected in ((19, None), (20, LOAD)):
        assert decision(compared(samples, disturbance=15.0, load=16.0)) == expected


@pytest.mark.parametrize("nothing", [0.0, -40.0, 40.0])
@pytest.mark.parametrize(("lead", "expected"), [(7.99, NOTHING), (8.01, DISTURBANCE)])
def test_anything_but_nothing_needs_proof(lead: float, nothing: float, expected: int) -> None:
    assert decision(compared(20, nothing=nothing, disturbance=nothing + lead)) == expected


@pytest.mark.parametrize("kind", [LOAD, BOTH])
@pytest.mark.parametrize(("disturbance", "expected"), [(9.0, DISTURBANCE), (-1.0, NOTHING)])
def test_a_load_that_cannot_be_waits_and_loses(
    kind: int, disturbance: float, expected: int
) -> None:
    for samples, found in ((39, None), (40, expected)):
        rivals = compared(samples, disturbance=disturbance)
        branch = rivals.branches[kind]
        branch.score, branch.theta[1] = 30.0, -9.0
        assert not riv.is_possible(branch.theta, LEARNING, MOTOR)
        assert decision(rivals) == found


@given(st.floats(0.3, 2.0), st.floats(1.0, 100.0))
def test_a_load_is_possible_where_it_is_damped_as_is_asked_for(
    damping: float, tau_s: float
) -> None:
    model = [0.0, 0.0, 0.011 / tau_s**2], [1.0, 2.0 * damping / tau_s, 1.0 / tau_s**2]
    values = [*theta_of(LEARNING, MOTOR, *model), 0.0, 0.0, 0.0]
    assert riv.is_possible(values, replace(LEARNING, damping_min=0.0), MOTOR)
    for least in (0.9, 1.2):
        if abs(damping - least) > 1e-3:
            learning = replace(LEARNING, damping_min=least)
            assert riv.is_possible(values, learning, MOTOR) is (damping > least)


@pytest.mark.parametrize("denominator", [[1.0, -0.2, 0.01], [1.0, 0.9, -0.01], [1.0, 0.9, 0.0]])
def test_a_load_that_grows_is_impossible(denominator: list[float]) -> None:
    values = [*theta_of(LEARNING, MOTOR, [0.0, 0.0, 1e-4], denominator), 0.0, 0.0, 0.0]
    assert riv.is_possible(values, LEARNING, MOTOR) is False


def test_a_battery_that_loses_is_possible_whatever_its_time_constant() -> None:
    load = battery_load(0.25, 0.3, 0.05, 60.0)
    for tau_s, possible in ((1.0, True), (500.0, True), (-5.0, False)):
        values = theta_of(LEARNING, load, [1.0, 1.0 / tau_s], [1.0, 1.0 / tau_s])
        assert riv.is_possible([*values, 0.0, 0.0], LEARNING, load) is possible


def test_loads_that_were_found_are_counted_and_forgotten() -> None:
    rivals = compared(5)
    for kind, loads in ((NOTHING, 0.0), (DISTURBANCE, 0.0), (LOAD, 1.0), (BOTH, 2.0)):
        rivals.samples, rivals.kind = 1, kind
        riv.settle(rivals)
        assert rivals.samples == 0
        assert rivals.loads == loads
    riv.settle(rivals)
    assert rivals.loads == 2.0
    for _ in range(150):
        riv.forget_changes(rivals)
    assert rivals.loads == pytest.approx(2.0 / math.e, rel=0.01)


def test_disturbances_add_up_by_their_squares_and_are_forgotten() -> None:
    rivals = compared(6)
    rivals.offset, rivals.moved = 0.02, 0.0
    for offset in (0.05, -0.02, math.nan):
        riv.note_disturbance(rivals, offset)
    assert rivals.moved == pytest.approx(0.03**2 + 0.04**2)
    for _ in range(150):
        riv.forget_changes(rivals)
    assert rivals.moved == pytest.approx(0.0025 / math.e, rel=0.01)


def test_the_variance_that_remains_is_a_mean_with_the_prior() -> None:
    rivals = compared(6)
    rivals.kind, rivals.anchor.power, rivals.branches[LOAD].squares = LOAD, 1e-4, 5e-4
    assert riv.explained_power(rivals) == pytest.approx((4.0 * 1e-4 + 5e-4) / 10.0)
    rivals.anchor.power = rivals.branches[LOAD].squares = 0.0
    assert riv.explained_power(rivals) == 1e-8


# the challenger


def begun(one: Case) -> tuple[chal.Challenger, Branch]:
    """A challenger, and the estimate."""
    challenger, estimate = chal.Challenger(new_branch(COUNT), judged=9), new_branch(COUNT)
    for branch in (challenger.branch, estimate):
        branch.squares = branch.logs = 9.0
    riv.prepare(one.rivals, POWER)
    chal.begin(challenger, estimate, one.rivals, LEARNING, MOTOR)
    return challenger, estimate


def test_it_learns_all_samples_since_the_anchor_without_judging_them() -> None:
    one = case(8)
    (challenger, estimate), expected = begun(one), bayes(ANEW, one)
    assert challenger.branch.theta == pytest.approx(expected.mean, abs=1e-6)
    assert challenger.samples == 8
    assert challenger.power == POWER
    assert (challenger.judged, estimate.squares, estimate.logs) == (0, 0.0, 0.0)
    assert (challenger.branch.squares, challenger.branch.logs) == (0.0, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_its_lead_is_the_ratio_of_both_likelihoods(seed: int) -> None:
    """Each predicts a sample before it learns it; the estimate here learns like any other."""
    one, random = case(9, seed), np.random.default_rng(seed)
    (challenger, estimate), new, old = begun(one), bayes(ANEW, one), bayes(NOTHING, one)
    for bayesian in (new, old):
        bayesian.squares, bayesian.samples, bayesian.log_density = 0.0, 0, 0.0
    for number in range(12):
        r, time_s = regressor(random), 40.0 + number
        target = float(np.dot(r, theta(2.6)) + 0.002 * random.normal())
        seen = filled(r, time_s - 2.0)
        estimate.excitation = float(seen @ old.covariance @ seen)
        estimate.innovation = target - float(seen @ old.mean)
        new.take(filled(r, time_s - 30.0), target)
        old.take(seen, target)
        chal.follow(challenger, LEARNING, MOTOR, Datum(r, target, time_s), estimate)
        assert r == pytest.approx(filled(r, time_s - 30.0))
        assert challenger.samples in {0, 10 + number}
        if challenger.judged == new.samples:
            lead = new.log_density - old.log_density
            assert chal.lead(challenger, estimate) == pytest.approx(lead, rel=1e-6, abs=1e-6)
    assert challenger.judged == 12


def test_a_prediction_of_an_untrained_challenger_is_not_judged() -> None:
    for excitation, judged in ((1.0, 1), (1e6, 0)):
        one = case(1)
        challenger, estimate = begun(one)
        estimate.excitation, estimate.innovation = 0.1, 0.01
        ud.open_up(challenger.branch.upper, challenger.branch.diagonal, excitation / 3.0)
        chal.follow(challenger, LEARNING, MOTOR, Datum(one.regressors[0], 0.9, 40.0), estimate)
        assert challenger.judged == judged


def led(lead: float, judged: int, samples: int = 20) -> tuple[chal.Challenger, Branch]:
    """A challenger that leads by so much through the logarithms of the estimate."""
    branch, estimate = new_branch(COUNT), new_branch(COUNT)
    branch.theta[:] = theta()
    estimate.logs = 2.0 * lead
    return chal.Challenger(branch, power=POWER, samples=samples, judged=judged), estimate


@pytest.mark.parametrize("judged", [0, 99])
@pytest.mark.parametrize(
    ("lead", "loads", "wins"),
    [(27.01, 0.0, True), (26.99, 0.0, False), (40.51, 1.5, True), (40.49, 1.5, False)],
)
def test_it_wins_by_twenty_seven_and_nine_for_each_load_found_lately(
    lead: float, loads: float, judged: int, wins: bool
) -> None:
    challenger, estimate = led(lead, judged)
    assert chal.lead(challenger, estimate) == pytest.approx(lead)
    assert chal.has_won(challenger, estimate, loads, LEARNING, MOTOR) is wins
    assert chal.has_won(*led(lead, judged, samples=0), loads, LEARNING, MOTOR) is False
    challenger.branch.theta[1] = -9.0
    assert chal.has_won(challenger, estimate, loads, LEARNING, MOTOR) is False


def followed(lead: float, samples: int) -> int:
    """Samples of a challenger after one that supports neither."""
    challenger, estimate = led(lead, 5, samples)
    ud.open_up(challenger.branch.upper, challenger.branch.diagonal, 1e-12)
    r = regressor(np.random.default_rng(1))
    target = float(np.dot(filled(r, 40.0), theta()))
    chal.follow(challenger, LEARNING, MOTOR, Datum(r, target, 40.0), estimate)
    return challenger.samples


def test_it_gives_up_when_it_is_beaten_or_after_a_hundred_and_fifty_samples() -> None:
    assert followed(0.0, 149) == 150
    assert followed(0.0, 150) == 0
    assert followed(-9.99, 20) == 21
    assert followed(-10.01, 20) == 0


def test_a_challenger_with_a_sum_that_is_no_number_does_not_win() -> None:
    for power, squares in ((math.nan, 1.0), (POWER, math.nan)):
        challenger, estimate = led(30.0, 5)
        challenger.power, estimate.squares = power, squares
        assert not chal.lead(challenger, estimate) > 0.0
        assert not chal.has_won(challenger, estimate, 0.0, LEARNING, MOTOR)


@pytest.mark.parametrize(("error", "surprised"), [(1.7, False), (1.8, True), (-1.8, True)])
def test_a_sample_beyond_the_root_of_three_deviations_is_new_to_it(
    error: float, surprised: bool
) -> None:
    """z² above the drift of the detector, 3."""
    (challenger, _), r = led(0.0, 5), regressor(np.random.default_rng(2))
    ud.open_up(challenger.branch.upper, challenger.branch.diagonal, 1e-9)
    target = float(np.dot(filled(r, 40.0), theta())) + error * math.sqrt(POWER)
    ask = (LEARNING, MOTOR, Datum(r, target, 40.0))
    assert chal.is_surprised(challenger, *ask) is surprised
    challenger.samples = 0
    assert chal.is_surprised(challenger, *ask) is True


def test_what_remains_of_its_variance_and_a_new_count() -> None:
    challenger, estimate = led(0.0, 6)
    challenger.branch.squares = 5e-4
    power = posterior_power(challenger.branch, 1e-4, challenger.judged)
    assert power == pytest.approx((4.0 * 1e-4 + 5e-4) / 10.0)
    estimate.squares, estimate.logs, challenger.branch.logs = 1.0, 2.0, 3.0
    chal.recount(challenger, estimate)
    assert (estimate.squares, estimate.logs, challenger.judged) == (0.0, 0.0, 0)
    assert (challenger.branch.squares, challenger.branch.logs) == (0.0, 0.0)
