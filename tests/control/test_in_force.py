"""The estimate in force of the two, what it reports, and the parameters that walk."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adaptdrive.control import estimator as est
from adaptdrive.control import in_force
from adaptdrive.control.branch import Branch, Datum
from adaptdrive.control.drift import OFFSET_WALK, learn_sample, walking_count
from adaptdrive.control.integrated import follow
from adaptdrive.control.ud_factors import covariance
from tests.closed_loop.bench import MOTOR, SCALED_LEARNING

LEARNING = replace(SCALED_LEARNING, bias=True, initial_state=True, alert=True)
BOTH = pytest.mark.parametrize("walks", [False, True])


def two_estimates(*, walks: bool) -> est.EstimatorState:
    """Two estimates that differ in every number; the one whose bias walks may be in force."""
    state = est.new_estimator(LEARNING, MOTOR, 2)
    count = len(state.estimate.theta)
    state.estimate.theta[:] = [1.0] * count
    state.estimate.diagonal[:] = [2.0] * count
    state.residual_power, state.residual_weight = 48.0, count + 3.0
    state.innovation, state.excitation = 0.25, 0.5
    walking = state.integrated
    walking.branch.theta[:] = [3.0] * count
    walking.branch.diagonal[:] = [4.0] * count
    walking.branch.innovation, walking.branch.excitation = 0.125, 0.75
    walking.residual_power, walking.residual_weight = 8.0, count + 2.0
    walking.in_force, walking.samples = walks, 50
    return state


@BOTH
def test_parameters_covariance_and_noise_are_those_of_the_estimate_in_force(walks: bool) -> None:
    state = two_estimates(walks=walks)
    assert in_force.in_force(state).theta[0] == (3.0 if walks else 1.0)
    assert in_force.in_force(state).diagonal[0] == (4.0 if walks else 2.0)
    assert in_force.residual_noise(state) == (2.0 if walks else 4.0)


@BOTH
def test_innovation_and_excitation_are_those_of_the_estimate_in_force(walks: bool) -> None:
    """The innovation in the unit of the output, of which a branch knows the scaled one."""
    state = two_estimates(walks=walks)
    in_force.show(state, LEARNING)
    expected = (0.125 * LEARNING.output_scale, 0.75) if walks else (0.25, 0.5)
    assert (state.innovation, state.excitation) == expected


@pytest.mark.parametrize(("more", "known"), [(-1.0, False), (0.0, False), (1.0, True)])
def test_noise_is_known_from_more_samples_than_parameters(more: float, *, known: bool) -> None:
    state = two_estimates(walks=False)
    state.residual_weight = len(state.estimate.theta) + more
    assert math.isfinite(in_force.residual_noise(state)) is known


@pytest.mark.parametrize("excitation", [0.0, 0.5, 30.0])
def test_the_residual_is_the_noise_that_would_make_such_an_innovation(excitation: float) -> None:
    """ε² has the mean σ² (1 + rᵀPr/ρ)."""
    state, sigma = two_estimates(walks=False), 0.01
    spread = sigma * math.sqrt(1.0 + excitation / LEARNING.forgetting)
    state.innovation, state.excitation = spread * LEARNING.output_scale, excitation
    assert in_force.own_residual(state, LEARNING) == pytest.approx(sigma**2)


def test_the_estimate_whose_bias_walks_begins_where_the_other_is() -> None:
    state = two_estimates(walks=False)
    state.integrated.samples, state.integrated.lead = 0, 5.0
    state.estimate.origin_s, state.sample.time_s = 7.0, 100.0
    before = covariance(state.estimate.upper, state.estimate.diagonal)
    state.sample.target = float(np.dot(state.estimate.theta, state.sample.regressor))
    follow(state.integrated, LEARNING, MOTOR, state.sample, state.estimate)
    branch = state.integrated.branch
    assert branch.theta == pytest.approx(state.estimate.theta)
    assert branch.origin_s == 7.0
    assert (state.integrated.samples, state.integrated.lead) == (1, 0.0)
    widened = np.array(covariance(branch.upper, branch.diagonal)) - np.array(before)
    assert np.abs(widened.ravel()[:-1]).max() < 0.2
    assert widened.ravel()[-1] > 100.0


@pytest.mark.parametrize(
    ("bias", "charge", "drifts", "walking"),
    [
        (False, False, False, 0),
        (False, False, True, 0),
        (False, True, False, 0),
        (True, False, False, 0),
        (True, False, True, 1),
        (True, True, False, 2),
        (True, True, True, 2),
    ],
)
def test_an_offset_that_drifts_walks_and_so_do_an_emf_and_its_rise(
    bias: bool, charge: bool, drifts: bool, walking: int
) -> None:
    learning = replace(LEARNING, bias=bias, charge=charge, drifts=drifts)
    assert walking_count(learning) == walking


@pytest.mark.parametrize("drifts", [False, True])
def test_an_offset_that_drifts_is_less_certain_by_its_walk(drifts: bool) -> None:
    """A sample of it alone leaves 1/(1/p + 1), and the walk adds its variance."""
    learning = replace(LEARNING, drifts=drifts, forgetting=1.0)
    branch = Branch([0.0, 0.0], [1.0, 0.0, 0.0, 1.0], [0.25, 0.5])
    learn_sample(branch, Datum([0.0, 1.0], 0.3), learning, 0.0)
    variances = np.diag(np.array(covariance(branch.upper, branch.diagonal)).reshape(2, 2))
    walked = OFFSET_WALK**2 if drifts else 0.0
    assert variances == pytest.approx([0.25, 0.5 / 1.5 + walked])
    assert branch.theta == pytest.approx([0.0, 0.3 / 3.0])


@pytest.mark.parametrize(("bias", "charge"), [(False, False), (True, True)])
def test_without_a_bias_or_with_an_emf_there_is_no_second_estimate(
    bias: bool, charge: bool
) -> None:
    state = two_estimates(walks=False)
    state.integrated.samples = 0
    learning = replace(LEARNING, bias=bias, charge=charge)
    follow(state.integrated, learning, MOTOR, state.sample, state.estimate)
    assert state.integrated.samples == 0


def test_the_walk_of_an_emf_is_not_added_with_its_samples() -> None:
    """The estimator adds it once in each slow period, whether a sample teaches or not."""
    learning = replace(LEARNING, charge=True, forgetting=1.0)
    upper = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    branch = Branch([0.0] * 3, upper, [0.25, 0.5, 0.5])
    learn_sample(branch, Datum([0.0, 0.0, 1.0], 0.3), learning, 0.0)
    variances = np.diag(np.array(covariance(branch.upper, branch.diagonal)).reshape(3, 3))
    assert variances == pytest.approx([0.25, 0.5, 0.5 / 1.5])
