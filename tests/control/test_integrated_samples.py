"""Datum by sample: how the estimate whose bias walks is compared, in dense matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from adaptdrive.control import estimator as est
from adaptdrive.control.branch import Branch, Datum, copy_estimate, new_branch
from adaptdrive.control.integrated import Integrated, follow
from adaptdrive.control.surprise import move_median
from adaptdrive.control.ud_factors import covariance
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING
from tests.control.systems import Array

LEARNING = replace(SCALED_LEARNING, bias=True, alert=True, forgetting=0.98, gate=0.0)
RHO, FLOOR, ROUNDING = 0.98, 1e-8, 3e-4
BEFORE, WORSE, BETTER, END = 30, 30, 110, 260
"""Samples from which on the other estimate predicts worse, and better again; and their number."""


def started() -> Integrated:
    """Return a comparison that begins with parameters of which a little is known."""
    integrated = est.new_estimator(LEARNING, MOTOR, 2).integrated
    integrated.branch.diagonal[:] = [4.0] * len(integrated.branch.theta)
    for i in range(len(integrated.branch.theta)):
        integrated.branch.upper[i * len(integrated.branch.theta) + i] = 1.0
    return integrated


@dataclass
class Books:
    """What the formulas of the module say, with σ² from the medians."""

    lead: float = 0.0
    power: float = 0.0
    other: float = 0.0
    in_force: bool = False
    residual_power: float = 0.0
    residual_weight: float = 0.0
    samples: int = 0

    def take(self, own: float, excitation: float, squared: float, other_excitation: float) -> None:
        """Take in one sample: ε² ρ/(ρ + rᵀPr) and rᵀPr of both estimates."""
        self.samples += 1
        if self.samples > 20:
            gain = loss(squared, other_excitation, self.other) - loss(own, excitation, self.power)
            self.lead = (1.0 - 1.0 / 60.0) * self.lead + gain
        if self.samples == 1:
            self.power, self.other = own, squared
        self.power = max(FLOOR / 900.0, move_median(self.power, own, 0.2))
        self.other = max(FLOOR / 900.0, move_median(self.other, squared, 0.2))
        self.in_force = self.lead > (0.0 if self.in_force else 20.0)
        self.residual_power = RHO * self.residual_power + own
        self.residual_weight = RHO * self.residual_weight + 1.0


def loss(normalised: float, excitation: float, power: float) -> float:
    error = normalised * (1.0 + excitation / RHO)
    variance = max(FLOOR, ROUNDING**2, power * (1.0 + excitation / RHO))
    return 0.5 * (math.log(variance) + min(error / variance, 12.0))


def dense(integrated: Integrated) -> tuple[Array, Array]:
    branch = integrated.branch
    count = len(branch.theta)
    matrix = np.array(covariance(branch.upper, branch.diagonal)).reshape(count, count)
    return np.array(branch.theta), matrix


def other(integrated: Integrated, squared: float, excitation: float) -> Branch:
    """The estimate whose bias rests, with a prediction of given ε² ρ/(ρ + rᵀPr) and rᵀPr."""
    branch = new_branch(len(integrated.branch.theta))
    copy_estimate(branch, integrated.branch)
    branch.excitation = excitation
    branch.innovation = math.sqrt(squared * (RHO + excitation) / RHO)
    return branch


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_comparison_is_that_of_the_formulas(seed: int) -> None:
    random, integrated, books, course = np.random.default_rng(seed), started(), Books(), []
    truth = random.normal(size=len(integrated.branch.theta))
    for number in range(END):
        h = number / LEARNING.tau_lambda_s
        known = np.array([math.exp(-h), h * math.exp(-h), 1.0])
        regressor = np.concatenate([random.normal(size=3), known])
        target = float(regressor @ truth + 0.01 * random.normal())
        squared = float(random.chisquare(1)) * (4.0 if WORSE <= number < BETTER else 1e-4)
        excitation = float(random.uniform(0.0, 0.5))
        theta, matrix = dense(integrated)
        own_excitation = float(regressor @ matrix @ regressor)
        own = float(target - regressor @ theta) ** 2 * RHO / (RHO + own_excitation)
        books.take(own, own_excitation, squared, excitation)
        sample = Datum(regressor.tolist(), target, float(number), ROUNDING)
        follow(integrated, LEARNING, MOTOR, sample, other(integrated, squared, excitation))
        assert integrated.lead == pytest.approx(books.lead, rel=1e-6, abs=1e-6)
        assert integrated.in_force is books.in_force
        assert integrated.residual_power == pytest.approx(books.residual_power, rel=1e-6)
        assert integrated.residual_weight == pytest.approx(books.residual_weight)
        course.append(integrated.in_force)
    assert not course[BEFORE - 1]
    assert course[BETTER - 1]
    assert not course[-1]


def test_after_each_sample_the_bias_is_uncertain_by_thirty_sigma_more() -> None:
    integrated = started()
    regressor = [0.0] * (len(integrated.branch.theta) - 1) + [1.0]
    for number in range(5):
        sample = Datum(regressor, 0.1, float(number), ROUNDING)
        follow(integrated, LEARNING, MOTOR, sample, other(integrated, 1e-4, 0.1))
        assert 900.0 <= dense(integrated)[1][-1, -1] <= 905.0


def test_a_jump_of_the_bias_is_followed_at_once() -> None:
    """Its size counts for σ ε/σ: the sample says nearly all of it."""
    integrated, count = started(), len(started().branch.theta)
    regressor = [0.0] * (count - 1) + [1.0]
    for number in range(60):
        target = 0.01 * (-1.0) ** number + (50.0 if number == 59 else 0.0)
        sample = Datum(regressor, target, float(number), ROUNDING)
        follow(integrated, LEARNING, MOTOR, sample, other(integrated, 1e-4, 0.1))
    assert dense(integrated)[0][-1] == pytest.approx(50.0, rel=1e-3)
