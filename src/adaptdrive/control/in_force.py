"""The estimate in force: the one whose bias rests, or the one whose bias walks (`integrated`)."""

from __future__ import annotations

import math

from adaptdrive.control import rls
from adaptdrive.control.branch import Branch
from adaptdrive.control.certainty import root_of
from adaptdrive.control.estimator import EstimatorState
from adaptdrive.control.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.vectors import Vector


def show(state: EstimatorState, learning: Learning) -> None:
    """Publish innovation and excitation of the estimate in force."""
    if state.integrated.in_force:
        state.innovation = state.integrated.branch.innovation * learning.output_scale
        state.excitation = state.integrated.branch.excitation


def in_force(state: EstimatorState) -> Branch:
    """Return the estimate in force."""
    return state.integrated.branch if state.integrated.in_force else state.estimate


def own_residual(state: EstimatorState, learning: Learning) -> float:
    """Squared innovation of the last sample, the estimate's own uncertainty taken out, scaled."""
    innovation = state.innovation / learning.output_scale
    return rls.normalised(state.excitation, innovation, learning.forgetting)


def residual_noise(state: EstimatorState) -> float:
    """σ of the innovations, scaled; NaN before there are more of them than parameters."""
    power, weight = state.residual_power, state.residual_weight
    if state.integrated.in_force:
        power, weight = state.integrated.residual_power, state.integrated.residual_weight
    freedom = weight - len(state.estimate.theta)
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
    return root_of(in_force(state), residual_noise(state), learning, load, values)
