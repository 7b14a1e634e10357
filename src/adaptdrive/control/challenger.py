"""A second estimate, learnt anew from an alarm on, against the estimate that came out of it.

A comparison of explanations (`rivals`) ends after some seconds. Another load that its samples
hardly show can look like a disturbance, then, when the reference moves, like the next one. The
challenger assumes nothing but that something changed: from the anchor on the load, its gain, the
offset and the state are free, so that an impact is no hindrance either. Both predict each sample
before they learn it. With σ² known only as σ0² from ν0 samples the logarithm of the ratio of their
likelihoods is

    Λ = 1/2 Σ ln((ρ + rᵀPr)/(ρ + rᵀP'r)) + (ν0 + n)/2 ln((ν0 σ0² + S)/(ν0 σ0² + S'))

S = Σ ε² ρ/(ρ + rᵀPr), over the samples after the challenger's training (A. P. Dawid, J. R. Stat.
Soc. A 147, 1984). When Λ is large enough, the challenger becomes the estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rls
from adaptdrive.control.drift import learn_sample
from adaptdrive.control.evidence import CLEAR, LIFE, RARER
from adaptdrive.control.hypotheses import (
    ANEW,
    Branch,
    copy_estimate,
    count_prediction,
    predict_sample,
    restart_past,
    squared_error,
    widen,
)
from adaptdrive.control.load import Load
from adaptdrive.control.rivals import PRIOR_SAMPLES, Rivals, is_possible
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import DRIFT
from adaptdrive.control.vectors import Vector

_PROOF = 27.0
"""Λ at which the challenger takes over: at 12 one of 60 torque steps passed for a load."""

_TRAINED = 10.0
"""Largest rᵀPr of a prediction that counts: the samples before are training."""


@dataclass(slots=True)
class Challenger:
    """The second estimate, and how both have predicted.

    Attributes:
        branch: θ, P and origin; its sums are S' and Σ ln(1 + rᵀP'r/ρ).
        squares: S of the estimate.
        logs: Σ ln(1 + rᵀPr/ρ) of the estimate.
        power: σ0².
        samples: Samples since its start, 0 without one.
        judged: Samples that both have predicted.
    """

    branch: Branch
    squares: float = 0.0
    logs: float = 0.0
    power: float = 0.0
    samples: int = 0
    judged: int = 0


def begin(challenger: Challenger, rivals: Rivals, learning: Learning, load: Load) -> None:
    """Start at the anchor of an alarm, and learn the samples since then.

    Args:
        challenger: Overwritten.
        rivals: The anchor, the estimate at it, and the samples since.
        learning: Scales and forgetting.
        load: Order and structure.
    """
    copy_estimate(challenger.branch, rivals.calm)
    restart_past(challenger.branch, learning, load, rivals.anchor.time_s)
    widen(challenger.branch, ANEW, learning, load, rivals.anchor)
    challenger.power = rivals.anchor.power
    challenger.samples = 0
    recount(challenger)
    count = len(challenger.branch.theta)
    regressor = [0.0] * count
    for number in range(rivals.waiting):
        for i in range(count):
            regressor[i] = rivals.regressors[number * count + i]
        target, time_s = rivals.targets[number], rivals.times_s[number]
        predict_sample(challenger.branch, learning, load, regressor, target, time_s)
        _learn(challenger, learning, regressor, target)


def is_surprised(
    challenger: Challenger,
    learning: Learning,
    load: Load,
    regressor: Vector,
    target: float,
    time_s: float,
) -> bool:
    """Return whether a sample that gave an alarm is new to the challenger too, or there is none.

    Args:
        challenger: The innovation of its branch is overwritten.
        learning: Forgetting.
        load: Order.
        regressor: r; the functions of the initial state in it are overwritten.
        target: What r predicts, scaled.
        time_s: When it was taken.
    """
    if challenger.samples == 0:
        return True
    predict_sample(challenger.branch, learning, load, regressor, target, time_s)
    return squared_error(challenger.branch, learning.forgetting) > DRIFT * challenger.power


def recount(challenger: Challenger) -> None:
    """Judge from now on only."""
    challenger.squares = challenger.logs = 0.0
    challenger.branch.squares = challenger.branch.logs = 0.0
    challenger.judged = 0


def follow(
    challenger: Challenger,
    learning: Learning,
    load: Load,
    regressor: Vector,
    target: float,
    time_s: float,
    excitation: float,
    innovation: float,
) -> None:
    """Let both predict a sample, and learn it.

    Args:
        challenger: Overwritten.
        learning: Forgetting.
        load: Order.
        regressor: r; the functions of the initial state in it are overwritten.
        target: What r predicts, scaled.
        time_s: When it was taken.
        excitation: rᵀPr of the estimate.
        innovation: ε of the estimate, scaled.
    """
    branch, forgetting = challenger.branch, learning.forgetting
    predict_sample(branch, learning, load, regressor, target, time_s)
    if branch.excitation <= _TRAINED:
        challenger.judged += 1
        challenger.squares += rls.normalised(excitation, innovation, forgetting)
        challenger.logs += math.log(1.0 + excitation / forgetting)
        count_prediction(branch, forgetting)
    _learn(challenger, learning, regressor, target)
    if challenger.samples > LIFE or lead(challenger) < -CLEAR:
        challenger.samples = 0


def _learn(challenger: Challenger, learning: Learning, regressor: Vector, target: float) -> None:
    branch = challenger.branch
    challenger.samples += 1
    learn_sample(branch.theta, branch.upper, branch.diagonal, regressor, target, learning, 0.0)


def lead(challenger: Challenger) -> float:
    """Return Λ: how much better than the estimate the challenger has predicted."""
    prior = PRIOR_SAMPLES * challenger.power
    if not prior > 0.0:
        return 0.0
    ratio = (prior + challenger.squares) / (prior + challenger.branch.squares)
    if not ratio > 0.0:
        return 0.0
    weight = PRIOR_SAMPLES + challenger.judged
    return 0.5 * (challenger.logs - challenger.branch.logs + weight * math.log(ratio))


def has_won(challenger: Challenger, loads: float, learning: Learning, load: Load) -> bool:
    """Return whether the challenger is to be the estimate.

    Args:
        challenger: As it has predicted.
        loads: Changes of the load that were found lately; each makes another one less credible.
        learning: Scales and bounds.
        load: Order and structure.
    """
    if challenger.samples == 0 or not lead(challenger) >= _PROOF + RARER * loads:
        return False
    return is_possible(challenger.branch.theta, learning, load)


def posterior_power(challenger: Challenger) -> float:
    """Return σ² as the challenger leaves it."""
    weight = PRIOR_SAMPLES + challenger.judged
    return (PRIOR_SAMPLES * challenger.power + challenger.branch.squares) / weight
