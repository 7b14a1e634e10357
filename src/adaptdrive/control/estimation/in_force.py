"""The estimate in force, and what the load may have become since the samples last showed it.

P shows how well the samples have determined a load that stays as it is. That load may have changed
since: at rest any dynamics predict the same output, an alarm takes samples to be explained, and
what explains it best for the moment may be wrong. While that is so, the standard deviations shown
are those of P opened up for another load (`hypotheses`): the load is known as it was, and the
loop keeps the gains that it has.

P takes the innovations for independent. Under a disturbance that moves each resembles the one
before, and the deviations shown are wider by what that costs.

An explanation may divide what has happened wrongly between load and disturbance. With u_0 the scale
of the input, a disturbance d that passes for dynamics moves a parameter by about d/u_0 of its
value. The deviations shown therefore include sqrt(Σ (d/u_0)²) of the values, over the disturbances
that were found lately: others of their size may not have been.
"""

from __future__ import annotations

import math

from adaptdrive.control.estimation import rls, second_estimates
from adaptdrive.control.estimation.branch import Branch, copy_estimate
from adaptdrive.control.estimation.covariance import deviations_of, root_of
from adaptdrive.control.estimation.estimator import EstimatorState
from adaptdrive.control.estimation.hypotheses import load_direction
from adaptdrive.control.estimation.regression import fitted_order
from adaptdrive.control.estimation.rls import predict
from adaptdrive.control.estimation.ud_factors import widen
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.thresholds import EARLIEST, FEWEST, MEMORY, NOISE_FLOOR, UNKNOWN
from adaptdrive.control.vectors import Vector

# The estimate in force: the one whose bias rests, or the one whose bias walks (`second_estimates`).


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


# Doubt: what the load may have become since the samples last showed it.

_SHOWN = 30.0
"""Movement of a sample, in σ, by an α that is larger by 1: 3 σ for a quarter of a second disk."""


def note_age(state: EstimatorState, learning: Learning, load: Load) -> None:
    """Count the slow periods since a sample that would have shown another load.

    Args:
        state: r; the count is overwritten.
        learning: Scales.
        load: Order and structure.
    """
    state.unseen_periods += 1
    noise = math.sqrt(state.surprise.power)
    for i in range(fitted_order(learning, load)):
        direction = load_direction(state.estimate.theta, i, learning, load)
        if abs(predict(direction, state.sample.regressor)) > _SHOWN * noise:
            state.unseen_periods = 0


def is_doubtful(state: EstimatorState) -> bool:
    """Return whether the load may be another than the estimate."""
    return state.unseen_periods > FEWEST or is_contested(state)


def is_contested(state: EstimatorState) -> bool:
    """Return whether the latest samples speak for another load than the estimate."""
    if state.surprise.sum > 0.0 or state.rivals.samples > 0:
        return True
    challenger = state.challenger
    if challenger.samples == 0:
        return False
    return challenger.judged < EARLIEST or second_estimates.lead(challenger, state.estimate) > 0.0


def doubted_deviations(
    state: EstimatorState, learning: Learning, load: Load, values: Vector
) -> Vector:
    """Return the standard deviations to be shown: wider while the load may be another.

    Args:
        state: θ and P; its opened estimate is overwritten.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    opened, noise = state.opened, residual_noise(state)
    copy_estimate(opened, in_force(state))
    noise = math.sqrt(
        noise * noise + NOISE_FLOOR + MEMORY * state.sample.rounding * state.sample.rounding
    )
    noise *= correlation_factor(state)
    if learning.alert and noise > 0.0 and is_doubtful(state):
        spread = UNKNOWN / noise
        for i in range(fitted_order(learning, load)):
            direction = load_direction(opened.theta, i, learning, load)
            widen(opened.upper, opened.diagonal, direction, spread * spread)
    own = deviations_of(opened, noise, learning, load, values)
    share = math.sqrt(state.rivals.moved)
    return [math.hypot(own[i], share * values[i]) for i in range(len(values))]
