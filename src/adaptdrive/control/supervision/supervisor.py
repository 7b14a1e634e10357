"""The supervisor: estimates are judged before they reach the gains.

What fails for longer than patience lasts falls back to the fixed controller. With little
excitation a wrong estimate can look sure of itself: a slow sine determines the gain and one more
number, not three. So an estimate must also be one that such a load can have. Masses, baths and
cells only store and lose: their poles are real, the damping of a second-order pair

    ζ = d_1 / (2 √d_0)                                  of s² + d_1 s + d_0

is at least 1, and what noise takes from that is little.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.design.pole_placement import STABLE_RADIUS
from adaptdrive.control.loads.load import is_damped
from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.vectors import Vector

_TINY = 1e-12
"""Below this a coefficient counts as zero: the model has no dc gain."""

_RESIDUAL_RATE = 1.0 / thresholds.WINDOW
"""Rate of the mean residuals: a mean over about 20 slow periods."""

_RESIDUAL_FLOOR = 100.0 * thresholds.NOISE_FLOOR
"""Ten times the least deviation, squared, a thousandth of the scale: at rest, less is noise."""


class Verdict(IntEnum):
    """Result of the supervisor's checks of an estimate."""

    TRUSTED = 0
    WARMING_UP = 1
    NOT_FINITE = 2
    UNSTABLE_LOAD = 3
    OUT_OF_BOUNDS = 4
    UNSTABLE_LOOP = 5
    UNCERTAIN = 6
    WORSE_THAN_FIXED = 7
    SETTLING = 8
    UNDERDAMPED = 9


@dataclass(slots=True)
class SupervisorState:
    """State of the supervisor.

    Attributes:
        verdict: The last verdict.
        out_of_bounds: Index of the parameter that was out of bounds.
        trusted: True while the adaptive gains may be in force.
        refused_periods: Refused estimates in a row.
        good_periods: Accepted estimates in a row.
        own_power: Slow mean square of the estimate's own innovations, scaled.
        fixed_power: The same of the nominal model.
        fixed_mean: Slow mean of the nominal model's innovations, scaled.
    """

    verdict: int = Verdict.WARMING_UP
    out_of_bounds: int = 0
    trusted: bool = False
    refused_periods: int = 0
    good_periods: int = 0
    own_power: float = 0.0
    fixed_power: float = 0.0
    fixed_mean: float = 0.0


def judge_model(numerator: Vector, denominator: Vector) -> int:
    """Check whether a continuous model can be used at all: finite, and with a dc gain."""
    finite = vectors.all_finite(numerator) and vectors.all_finite(denominator)
    if not finite or abs(denominator[len(denominator) - 1]) < _TINY:
        return Verdict.NOT_FINITE
    return Verdict.TRUSTED


def judge_bounds(
    values: Vector, nominal: Vector, supervision: SupervisionLimits, state: SupervisorState
) -> int:
    """Check whether every parameter is within its bounds around the nominal one."""
    for i, value in enumerate(values):
        ratio = value / nominal[i]
        if not supervision.ratio_min <= ratio <= supervision.ratio_max:
            state.out_of_bounds = i
            return Verdict.OUT_OF_BOUNDS
    return Verdict.TRUSTED


def judge_damping(denominator: Vector, supervision: SupervisionLimits) -> int:
    """Check that a model of second order is damped like a passive load with losses."""
    least = supervision.damping_min
    damped = not least > 0.0 or is_damped(denominator, least)
    return Verdict.TRUSTED if damped else Verdict.UNDERDAMPED


def compare_residuals(state: SupervisorState, own: float, fixed: float) -> None:
    """Remember how well the estimate and the nominal model predicted this sample.

    Args:
        state: Overwritten.
        own: Squared innovation of the estimate, its own uncertainty taken out, scaled.
        fixed: Innovation of the nominal model, scaled.
    """
    state.own_power += _RESIDUAL_RATE * (own - state.own_power)
    state.fixed_power += _RESIDUAL_RATE * (fixed * fixed - state.fixed_power)
    state.fixed_mean += _RESIDUAL_RATE * (fixed - state.fixed_mean)


def judge_residual(state: SupervisorState, supervision: SupervisionLimits) -> int:
    """Check whether the estimate predicts no worse than the nominal model does."""
    margin = supervision.residual_margin * supervision.residual_margin
    if margin > 0.0 and state.own_power > margin * state.fixed_power + _RESIDUAL_FLOOR:
        return Verdict.WORSE_THAN_FIXED
    return Verdict.TRUSTED


def better_than_nominal(state: SupervisorState) -> float:
    """Return rms errors of the nominal model over those of the estimate; 1 where both are small."""
    return _over_own_errors(state, state.fixed_power)


def moves_better_than_nominal(state: SupervisorState) -> float:
    """Return the ratio of `better_than_nominal` without the mean error of the nominal model.

    The integrator of the fixed controller removes a constant error, which a wrong gain or a load
    torque causes; wrong dynamics remain.
    """
    return _over_own_errors(state, state.fixed_power - state.fixed_mean * state.fixed_mean)


def _over_own_errors(state: SupervisorState, power: float) -> float:
    """Return an rms error over that of the estimate from its square; 1 where it is small."""
    if vectors.lacks(power, _RESIDUAL_FLOOR):
        return 1.0
    return math.sqrt(power / max(state.own_power, _RESIDUAL_FLOOR))


def judge_poles(polynomial: Vector, refusal: int) -> int:
    """Check whether a polynomial in z is finite and stable.

    Args:
        polynomial: A of the discrete model, or A_c of the designed loop.
        refusal: Verdict on one that is not stable.
    """
    if not vectors.all_finite(polynomial):
        return Verdict.NOT_FINITE
    return Verdict.TRUSTED if vectors.is_stable(polynomial, STABLE_RADIUS) else refusal


def take_verdict(
    state: SupervisorState,
    verdict: int,
    supervision: SupervisionLimits,
    periods: int,
    in_force: bool,
) -> bool:
    """Remember a verdict; return whether the new gains may take effect.

    The last trusted gains survive as many refusals in a row as patience allows. Doubt that comes
    up while they are in force counts as much as error: their own samples contradict the estimate,
    and gains for a heavier load than the present one oscillate before the new load is known. Doubt
    for lack of excitation, while they wait, leaves them as they are.

    Args:
        state: Overwritten.
        verdict: Of the estimate of this period.
        supervision: Warm-up and patience.
        periods: Slow periods since start.
        in_force: Whether the trusted gains are what holds the load.
    """
    state.verdict = verdict
    if verdict != Verdict.TRUSTED:
        contradicted = in_force and state.good_periods > 0
        if contradicted or not is_uncertain(verdict):
            state.refused_periods += 1
        state.good_periods = 0
        if state.refused_periods > supervision.patience_periods:
            state.trusted = False
        return False
    state.refused_periods = 0
    state.good_periods += 1
    if periods <= supervision.warm_up_periods:
        state.verdict = Verdict.WARMING_UP
        return False
    if state.good_periods < supervision.dwell_periods:
        state.verdict = Verdict.SETTLING
        return False
    state.trusted = True
    return True


def is_uncertain(verdict: int) -> bool:
    """Check whether the estimate is not wrong, but not known well enough."""
    return verdict in {Verdict.UNCERTAIN, Verdict.UNDERDAMPED}
