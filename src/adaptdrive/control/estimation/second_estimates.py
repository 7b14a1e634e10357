"""Second estimates: one learnt anew from an alarm on, and one whose bias is a random walk.

A comparison of explanations (`rivals`) ends after some seconds. Another load that its samples
hardly show can look like a disturbance, then, when the reference moves, like the next one. The
challenger assumes nothing but that something changed: from the anchor on the load, its gain, the
offset and the state are free, so that an impact is no hindrance either. Both predict each sample
before they learn it. Λ is the difference of their likelihoods L (`branch`), over the samples after
the challenger's training (A. P. Dawid, J. R. Stat. Soc. A 147, 1984). When it is large enough, the
challenger becomes the estimate.

Least squares take what acts with the input as a constant that jumps now and then. A torque that
swings is neither: its residuals are coloured, and dynamics that fit them come out. With

    y = rᵀθ + e       bias[k + 1] = bias[k] + w       σ_w = 30 σ_e

the noise of the model is integrated noise (Clarke, Mohtadi and Tuffs, Automatica 23, 1987,
doi:10.1016/0005-1098(87)90087-2), and only changes from sample to sample teach the dynamics. Such
an estimate withstands any slow disturbance, and learns less from each sample than one whose bias
rests. Which of the two describes the drive is seen from how well they predict:

    Λ <- (1 - 1/60) Λ + l - l_w      l = 1/2 (ln s² + min(ε²/s², 12))

with s² = σ² (1 + rᵀPr/ρ) and σ² from the median of ε² ρ/(ρ + rᵀPr), so that a sudden change, which
the explanations of an alarm deal with, counts little. The second estimate is in force from Λ > 20
to Λ < 0.
"""

import math
from dataclasses import dataclass

from adaptdrive.control.estimation import covariance, rls
from adaptdrive.control.estimation.branch import (
    Branch,
    Datum,
    copy_estimate,
    count_prediction,
    learn_sample,
    likelihood,
    predict_sample,
    squared_error,
    widen_last,
)
from adaptdrive.control.estimation.rivals import DRIFT, THRESHOLD, Rivals, is_possible, move_median
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.thresholds import CLEAR, FEWEST, LIFE, MEMORY, NOISE_FLOOR, RARER, WINDOW

# A second estimate, learnt anew from an alarm on, against the estimate that came out of it.

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
    covariance.restart_past(challenger.branch, learning, load, rivals.anchor.time_s)
    covariance.widen(challenger.branch, covariance.ANEW, learning, load, rivals.anchor)
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


# A second estimate for a disturbance that never rests: the bias of its model is a random walk.

_WALK = 30.0
"""Random walk of the bias in σ for each slow period: the last sample says nearly all of it."""

_RATE = 1.0 / FEWEST
"""Rate of the medians, a factor of 2 in 4 samples: a start with another load is soon forgotten."""

_LEAD = 2.0 * CLEAR
"""Λ from which it is in force, twice what decides between estimates whose noise is known: a swing
has 90 to 110, noise of 5 % after a change up to 40."""


@dataclass(slots=True)
class Integrated:
    """The second estimate, and how well both have predicted.

    Attributes:
        branch: θ, P and origin.
        power: σ² of its innovations, scaled.
        other: σ² of the innovations of the estimate whose bias rests.
        lead: Λ.
        samples: Samples seen.
        in_force: Whether it is the estimate.
        residual_power: Forgetting sum of squared normalised innovations.
        residual_weight: Forgetting count of them.
    """

    branch: Branch
    power: float = NOISE_FLOOR
    other: float = NOISE_FLOOR
    lead: float = 0.0
    samples: int = 0
    in_force: bool = False
    residual_power: float = 0.0
    residual_weight: float = 0.0


def applies(learning: Learning) -> bool:
    """Return whether a model has a bias that may walk; the EMF of a battery walks already."""
    return learning.bias and not learning.charge


def restart(integrated: Integrated) -> None:
    """Compare anew."""
    integrated.samples = 0
    integrated.lead = integrated.residual_power = integrated.residual_weight = 0.0
    integrated.in_force = False


def follow_integrated(
    integrated: Integrated, learning: Learning, load: Load, sample: Datum, estimate: Branch
) -> None:
    """Let the second estimate predict and learn a sample, and compare.

    Args:
        integrated: Overwritten; it begins where the other estimate is.
        learning: Forgetting and gate.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
        estimate: The estimate whose bias rests, which has predicted the sample.
    """
    if not applies(learning):
        return
    branch, rho = integrated.branch, learning.forgetting
    if integrated.samples == 0:
        copy_estimate(branch, estimate)
        restart(integrated)
    squared = rls.normalised(estimate.excitation, estimate.innovation, rho)
    predict_sample(branch, learning, load, sample)
    own = squared_error(branch, rho)
    least = max(NOISE_FLOOR, sample.rounding**2)  # below it better predictions show nothing
    integrated.samples += 1
    if integrated.samples > WINDOW:
        gain = _loss(squared, estimate.excitation / rho, integrated.other, least)
        gain -= _loss(own, branch.excitation / rho, integrated.power, least)
        integrated.lead += gain - integrated.lead / MEMORY
    _follow_noise(integrated, own, squared)
    if own > (DRIFT + THRESHOLD) * integrated.power:
        widen_last(branch, branch.innovation * branch.innovation / integrated.power)
    theta, regressor, target = branch.theta, sample.regressor, sample.target
    upper, diagonal = branch.upper, branch.diagonal
    rls.update_beside(theta, upper, diagonal, regressor, target, rho, learning.gate, 1)
    widen_last(branch, _WALK * _WALK)
    integrated.residual_power = rho * integrated.residual_power + own
    integrated.residual_weight = rho * integrated.residual_weight + 1.0


def _follow_noise(integrated: Integrated, own: float, squared: float) -> None:
    """Let the medians follow a sample, and choose the estimate in force."""
    if integrated.samples == 1:
        integrated.power, integrated.other = own, squared
    least = NOISE_FLOOR / (_WALK * _WALK)
    integrated.power = max(least, move_median(integrated.power, own, _RATE))
    integrated.other = max(least, move_median(integrated.other, squared, _RATE))
    integrated.in_force = integrated.lead > (0.0 if integrated.in_force else _LEAD)


def _loss(squared: float, excitation: float, power: float, least: float) -> float:
    """Return l: minus the logarithm of the likelihood of a sample, up to a constant."""
    spread = 1.0 + excitation
    variance = max(least, power * spread)
    return 0.5 * (math.log(variance) + min(squared * spread / variance, DRIFT + THRESHOLD))
