"""The estimate in force: the one whose bias rests, or the one whose bias walks (`integrated`)."""

from __future__ import annotations

import math

from adaptdrive.control import integrated as integ
from adaptdrive.control import rls
from adaptdrive.control.certainty import root_of
from adaptdrive.control.estimator import EstimatorState
from adaptdrive.control.hypotheses import copy_estimate
from adaptdrive.control.load import Load
from adaptdrive.control.regression import fill_initial_state
from adaptdrive.control.settings import Learning
from adaptdrive.control.vectors import Vector


def let_both_predict(
    state: EstimatorState, learning: Learning, load: Load, target: float, innovation: float
) -> None:
    """Let the estimate whose bias walks predict a sample and learn it, before the other learns it.

    Args:
        state: Its integrated estimate is overwritten.
        learning: Scales and forgetting.
        load: Order.
        target: What r predicts, scaled.
        innovation: ε of the estimate whose bias rests, scaled.
    """
    if not integ.applies(learning):
        return
    integrated, regressor, time_s = state.integrated, state.regressor, state.elapsed_s
    if integrated.samples == 0:
        _begin(state)
    excitation = state.excitation
    squared = rls.normalised(excitation, innovation, learning.forgetting)
    noise = state.rounding
    integ.follow(integrated, learning, load, regressor, target, time_s, squared, excitation, noise)
    fill_initial_state(regressor, learning, load, time_s - state.origin_s)


def _begin(state: EstimatorState) -> None:
    """Start where the estimate whose bias rests is."""
    copy_estimate(state.integrated.branch, state)
    integ.restart(state.integrated)


def show(state: EstimatorState, learning: Learning) -> None:
    """Publish innovation and excitation of the estimate in force."""
    integrated = state.integrated
    if integrated.in_force:
        state.innovation = integrated.branch.innovation * learning.output_scale
        state.excitation = integrated.branch.excitation


def theta_in_force(state: EstimatorState) -> Vector:
    """Return θ of the estimate in force."""
    return state.integrated.branch.theta if state.integrated.in_force else state.theta


def covariance_in_force(state: EstimatorState) -> tuple[Vector, Vector]:
    """Return U and D of P of the estimate in force."""
    branch = state.integrated.branch
    if state.integrated.in_force:
        return branch.upper, branch.diagonal
    return state.upper, state.diagonal


def own_residual(state: EstimatorState, learning: Learning) -> float:
    """Squared innovation of the last sample, the estimate's own uncertainty taken out, scaled."""
    innovation = state.innovation / learning.output_scale
    return rls.normalised(state.excitation, innovation, learning.forgetting)


def residual_noise(state: EstimatorState) -> float:
    """σ of the innovations, scaled; NaN before there are more of them than parameters."""
    power, weight = state.residual_power, state.residual_weight
    if state.integrated.in_force:
        power, weight = state.integrated.residual_power, state.integrated.residual_weight
    freedom = weight - len(state.theta)
    if freedom <= 0.0:
        return math.nan
    return math.sqrt(power / freedom)


def correlation_factor(state: EstimatorState) -> float:
    """Return the factor by which innovations that resemble their neighbours widen a deviation.

    n samples whose neighbours have the correlation φ tell as much as n (1 - φ)/(1 + φ) independent
    ones (G. V. Bayley and J. M. Hammersley, Suppl. J. Roy. Stat. Soc. 8, 1946,
    doi:10.2307/2983560), and no less than one. Noise has no correlation; the error that a moving
    disturbance leaves has one, and so has what came with an alarm, until it is forgotten: its
    explanation is not confirmed yet. A bias that walks follows a disturbance.

    Args:
        state: Sums over the innovations.
    """
    power, lag = state.residual_power, state.residual_lag
    if state.integrated.in_force or not lag > 0.0:
        return 1.0
    if lag >= power:
        return math.sqrt(state.residual_weight)
    return math.sqrt(min((power + lag) / (power - lag), state.residual_weight))


def parameter_root(state: EstimatorState, learning: Learning, load: Load, values: Vector) -> Vector:
    """L of the covariance L Lᵀ of the physical parameters, to first order.

    Args:
        state: θ and P.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    noise, theta = residual_noise(state), theta_in_force(state)
    upper, diagonal = covariance_in_force(state)
    return root_of(theta, upper, diagonal, noise, learning, load, values)
