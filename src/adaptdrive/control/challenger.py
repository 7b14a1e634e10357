"""A second estimate, learnt anew from an alarm on, against the estimate that came out of it.

A comparison of explanations (`rivals`) ends after some seconds. Another load that its samples
hardly show can look like a disturbance, then, when the reference moves, like the next one. The
challenger assumes nothing but that something changed: from the anchor on the load, its gain, the
offset and the state are free, so that an impact is no hindrance either. Both predict each sample
before they learn it. Λ is the difference of their likelihoods L (`branch`), over the samples after
the challenger's training (A. P. Dawid, J. R. Stat. Soc. A 147, 1984). When it is large enough, the
challenger becomes the estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control.branch import (
    Branch,
    Datum,
    copy_estimate,
    count_prediction,
    likelihood,
    predict_sample,
    squared_error,
)
from adaptdrive.control.drift import learn_sample
from adaptdrive.control.evidence import CLEAR, LIFE, RARER
from adaptdrive.control.hypotheses import ANEW, restart_past, widen
from adaptdrive.control.load import Load
from adaptdrive.control.rivals import Rivals, is_possible
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import DRIFT

_PROOF = 3.0 * RARER
"""Λ at which the challenger takes over: it assumes a load, a disturbance and a state that jumps. At
12 one of 60 torque steps passed for a load."""

_TRAINED = 10.0
"""Largest rᵀPr of a prediction that counts: the samples before are training."""


@dataclass(slots=True)
class Challenger:
    """The second estimate, and how both have predicted.

    Attributes:
        branch: θ, P and origin; its sums, and those of the estimate, are those of the samples that
            both have predicted.
        power: σ0².
        samples: Samples since its start, 0 without one.
        judged: Samples that both have predicted.
    """

    branch: Branch
    power: float = 0.0
    samples: int = 0
    judged: int = 0


def begin(
    challenger: Challenger, estimate: Branch, rivals: Rivals, learning: Learning, load: Load
) -> None:
    """Start at the anchor of an alarm, and learn the samples since then.

    Args:
        challenger: Overwritten.
        estimate: The estimate, whose sums begin anew.
        rivals: The anchor, the estimate at it, and the samples since.
        learning: Scales and forgetting.
        load: Order and structure.
    """
    copy_estimate(challenger.branch, rivals.calm)
    restart_past(challenger.branch, learning, load, rivals.anchor.time_s)
    widen(challenger.branch, ANEW, learning, load, rivals.anchor)
    challenger.power = rivals.anchor.power
    challenger.samples = 0
    recount(challenger, estimate)
    for number in range(rivals.waiting):
        predict_sample(challenger.branch, learning, load, rivals.kept[number])
        _learn(challenger, learning, rivals.kept[number])


def is_surprised(challenger: Challenger, learning: Learning, load: Load, sample: Datum) -> bool:
    """Return whether a sample that gave an alarm is new to the challenger too, or there is none.

    Args:
        challenger: The innovation of its branch is overwritten.
        learning: Forgetting.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
    """
    if challenger.samples == 0:
        return True
    predict_sample(challenger.branch, learning, load, sample)
    return squared_error(challenger.branch, learning.forgetting) > DRIFT * challenger.power


def recount(challenger: Challenger, estimate: Branch) -> None:
    """Judge from now on only."""
    for one in (challenger.branch, estimate):
        one.squares = one.logs = 0.0
    challenger.judged = 0


def follow(
    challenger: Challenger, learning: Learning, load: Load, sample: Datum, estimate: Branch
) -> None:
    """Let both predict a sample, and learn it.

    Args:
        challenger: Overwritten.
        learning: Forgetting.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
        estimate: The estimate, which has predicted it.
    """
    predict_sample(challenger.branch, learning, load, sample)
    if challenger.branch.excitation <= _TRAINED:
        challenger.judged += 1
        count_prediction(challenger.branch, learning.forgetting)
        count_prediction(estimate, learning.forgetting)
    _learn(challenger, learning, sample)
    if challenger.samples > LIFE or lead(challenger, estimate) < -CLEAR:
        challenger.samples = 0


def _learn(challenger: Challenger, learning: Learning, sample: Datum) -> None:
    challenger.samples += 1
    learn_sample(challenger.branch, sample, learning, 0.0)


def lead(challenger: Challenger, estimate: Branch) -> float:
    """Return Λ: how much better than the estimate the challenger has predicted."""
    power, count = challenger.power, challenger.judged
    return likelihood(challenger.branch, power, count) - likelihood(estimate, power, count)


def has_won(
    challenger: Challenger, estimate: Branch, loads: float, learning: Learning, load: Load
) -> bool:
    """Return whether the challenger is to be the estimate.

    Args:
        challenger: As it has predicted.
        estimate: As it has predicted.
        loads: Changes of the load that were found lately; each makes another one less credible.
        learning: Scales and bounds.
        load: Order and structure.
    """
    if challenger.samples == 0 or not lead(challenger, estimate) >= _PROOF + RARER * loads:
        return False
    return is_possible(challenger.branch.theta, learning, load)
