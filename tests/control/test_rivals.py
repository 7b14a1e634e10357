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
from adaptdrive.control.branch import Branch, Datum, copy_estimate, new_branch
from adaptdrive.control.hypotheses import (
    ANEW,
    BOTH,
    DISTURBANCE,
    LOAD,
    NOTHING,
    restart_past,
    widen,
)
from adaptdrive.control.regression import theta_of
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LEARNING = replace(SCALED_LEARNING, forgetting=1.0, bias=True, alert=True, initial_state=True)
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


# the challenger


def begun(one: Case) -> tuple[chal.Challenger, Branch]:
    """A challenger, and the estimate."""
    challenger, estimate = chal.Challenger(new_branch(COUNT), judged=9), new_branch(COUNT)
    for branch in (challenger.branch, estimate):
        branch.squares = branch.logs = 9.0
    riv.prepare(one.rivals, POWER)
    chal.begin(challenger, estimate, one.rivals, LEARNING, MOTOR)
    return challenger, estimate


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
