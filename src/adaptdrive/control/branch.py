"""A branch: an estimate with its covariance, and how well it has predicted.

The estimator holds several. One is its estimate; the others explain an alarm (`rivals`), challenge
the estimate (`challenger`) or follow a disturbance that never rests (`integrated`). With σ² known
only as σ0² from ν0 samples the logarithm of the likelihood of n samples is, up to a constant
(Bayesian linear regression with an inverse-gamma prior of σ²; Gelman et al., Bayesian Data
Analysis, chapter 14),

    L = -1/2 Σ ln(1 + rᵀPr/ρ) - (ν0 + n)/2 ln((ν0 σ0² + Σ ε² ρ/(ρ + rᵀPr)) / ((ν0 + n) σ0²))
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rls
from adaptdrive.control import ud_factors as ud
from adaptdrive.control.evidence import PRIOR_SAMPLES
from adaptdrive.control.load import Load
from adaptdrive.control.regression import fill_initial_state
from adaptdrive.control.settings import Learning
from adaptdrive.control.vectors import Vector, copy_into, unit


@dataclass(slots=True)
class Datum:
    """One slow sample, as the estimator sees it.

    Attributes:
        regressor: r, scaled; the functions of the initial state in it belong to the branch that
            has predicted it last.
        target: What r predicts, scaled.
        time_s: Time since start.
        rounding: Standard deviation of the rounding error of the output, scaled.
    """

    regressor: Vector
    target: float = 0.0
    time_s: float = 0.0
    rounding: float = 0.0


@dataclass(slots=True)
class Branch:
    """One estimate, and how well it has predicted.

    Attributes:
        theta: θ, scaled.
        upper: U of P = U D Uᵀ.
        diagonal: D.
        origin_s: Since when the functions of the initial state are counted.
        squares: Sum of ε² ρ / (ρ + rᵀPr).
        logs: Sum of ln(1 + rᵀPr / ρ).
        score: Logarithm of its likelihood, up to a constant.
        innovation: ε of the last sample, scaled.
        excitation: rᵀPr of the last sample.
    """

    theta: Vector
    upper: Vector
    diagonal: Vector
    origin_s: float = 0.0
    squares: float = 0.0
    logs: float = 0.0
    score: float = 0.0
    innovation: float = 0.0
    excitation: float = 0.0


def new_branch(count: int) -> Branch:
    """Return a branch for θ of a length."""
    return Branch([0.0] * count, [0.0] * (count * count), [0.0] * count)


def copy_estimate(target: Branch, source: Branch) -> None:
    """Overwrite θ, P, origin and the last prediction."""
    copy_into(target.theta, source.theta)
    copy_into(target.upper, source.upper)
    copy_into(target.diagonal, source.diagonal)
    target.origin_s = source.origin_s
    target.innovation, target.excitation = source.innovation, source.excitation


def predict(branch: Branch, sample: Datum) -> None:
    """Predict a sample, before it is learnt: innovation and excitation are overwritten."""
    branch.excitation = ud.excitation(branch.upper, branch.diagonal, sample.regressor)
    branch.innovation = sample.target - rls.predict(branch.theta, sample.regressor)


def predict_sample(branch: Branch, learning: Learning, load: Load, sample: Datum) -> None:
    """Predict a sample whose functions of the initial state are counted from the branch's origin.

    Args:
        branch: Innovation and excitation are overwritten.
        learning: τ_λ.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
    """
    fill_initial_state(sample.regressor, learning, load, sample.time_s - branch.origin_s)
    predict(branch, sample)


def squared_error(branch: Branch, forgetting: float) -> float:
    """Return ε² ρ/(ρ + rᵀPr) of the last prediction, the quotient first as in old sessions."""
    return branch.innovation * branch.innovation * (forgetting / (forgetting + branch.excitation))


def count_prediction(branch: Branch, forgetting: float) -> None:
    """Add the last prediction to the sums by which branches are compared."""
    branch.squares += squared_error(branch, forgetting)
    branch.logs += math.log(1.0 + branch.excitation / forgetting)


def likelihood(branch: Branch, power: float, count: int) -> float:
    """Return L of a branch that has predicted so many samples, from σ0²."""
    weight = PRIOR_SAMPLES + count
    mean = (PRIOR_SAMPLES * power + branch.squares) / power
    return -0.5 * (branch.logs + weight * math.log(mean / weight))


def posterior_power(branch: Branch, power: float, count: int) -> float:
    """Return σ² as a branch leaves it after so many samples, from σ0²."""
    return (PRIOR_SAMPLES * power + branch.squares) / (PRIOR_SAMPLES + count)


def widen_last(branch: Branch, variance: float) -> None:
    """Widen P along the last parameter, the bias."""
    direction = unit(len(branch.theta), len(branch.theta) - 1)
    ud.widen(branch.upper, branch.diagonal, direction, variance)
