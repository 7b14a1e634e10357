"""Second estimates: one learnt anew from an alarm on, and one whose bias is a random walk.

A comparison of explanations (`hypotheses`) ends after some seconds. Another load that its samples
hardly show can look like a disturbance, then, when the reference moves, like the next one. The
second filter assumes nothing but that something changed: from the anchor on the load, its gain, the
offset and the state are free, so that an impact is no hindrance either. Both predict each sample
before they learn it. Λ is the difference of their likelihoods L (`branch`), over the samples after
the second filter's training (A. P. Dawid, J. R. Stat. Soc. A 147, 1984). When it is large enough,
the second filter becomes the estimate.

Least squares take what acts with the input as a constant that jumps now and then. A torque that
swings is neither: its residuals are coloured, and dynamics that fit them come out. With

    y = rᵀθ + e       bias[k + 1] = bias[k] + w       σ_w = 30 σ_e

the noise of the model is incremental noise (Clarke, Mohtadi and Tuffs, Automatica 23, 1987,
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
    Observation,
    copy_estimate,
    count_prediction,
    learn_sample,
    likelihood,
    predict_sample,
    squared_error,
    widen_last,
)
from adaptdrive.control.estimation.hypothesis_test import (
    DRIFT,
    THRESHOLD,
    Hypotheses,
    is_possible,
    move_median,
)
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.thresholds import CLEAR, FEWEST, LIFE, MEMORY, NOISE_FLOOR, RARER, WINDOW

# A second estimate, learnt anew from an alarm on, against the estimate that came out of it.

_PROOF = 3.0 * RARER
"""Λ at which the second filter takes over: it assumes a load, a disturbance and a state that
jumps. At 12 one of 60 torque steps passed for a load."""

_TRAINED = 10.0
"""Largest rᵀPr of a prediction that counts: the samples before are training."""


@dataclass(slots=True)
class SecondFilter:
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
    second_filter: SecondFilter,
    estimate: Branch,
    hypotheses: Hypotheses,
    learning: EstimatorSettings,
    load: Load,
) -> None:
    """Start at the anchor of an alarm, and learn the samples since then.

    Args:
        second_filter: Overwritten.
        estimate: The estimate, whose sums begin anew.
        hypotheses: The anchor, the estimate at it, and the samples since.
        learning: Scales and forgetting.
        load: Order and structure.
    """
    copy_estimate(second_filter.branch, hypotheses.calm)
    covariance.restart_past(second_filter.branch, learning, load, hypotheses.anchor.time_s)
    covariance.widen(second_filter.branch, covariance.ANEW, learning, load, hypotheses.anchor)
    second_filter.power = hypotheses.anchor.power
    second_filter.samples = 0
    recount(second_filter, estimate)
    for number in range(hypotheses.waiting):
        predict_sample(second_filter.branch, learning, load, hypotheses.kept[number])
        _learn(second_filter, learning, hypotheses.kept[number])


def is_surprised(
    second_filter: SecondFilter, learning: EstimatorSettings, load: Load, sample: Observation
) -> bool:
    """Return whether a sample that gave an alarm is new to the second filter too, or there is none.

    Args:
        second_filter: The innovation of its branch is overwritten.
        learning: Forgetting.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
    """
    if second_filter.samples == 0:
        return True
    predict_sample(second_filter.branch, learning, load, sample)
    return squared_error(second_filter.branch, learning.forgetting) > DRIFT * second_filter.power


def recount(second_filter: SecondFilter, estimate: Branch) -> None:
    """Judge from now on only."""
    for one in (second_filter.branch, estimate):
        one.squares = one.logs = 0.0
    second_filter.judged = 0


def follow(
    second_filter: SecondFilter,
    learning: EstimatorSettings,
    load: Load,
    sample: Observation,
    estimate: Branch,
) -> None:
    """Let both predict a sample, and learn it.

    Args:
        second_filter: Overwritten.
        learning: Forgetting.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
        estimate: The estimate, which has predicted it.
    """
    predict_sample(second_filter.branch, learning, load, sample)
    if second_filter.branch.excitation <= _TRAINED:
        second_filter.judged += 1
        count_prediction(second_filter.branch, learning.forgetting)
        count_prediction(estimate, learning.forgetting)
    _learn(second_filter, learning, sample)
    if second_filter.samples > LIFE or lead(second_filter, estimate) < -CLEAR:
        second_filter.samples = 0


def _learn(second_filter: SecondFilter, learning: EstimatorSettings, sample: Observation) -> None:
    second_filter.samples += 1
    learn_sample(second_filter.branch, sample, learning, 0.0)


def lead(second_filter: SecondFilter, estimate: Branch) -> float:
    """Return Λ: how much better than the estimate the second filter has predicted."""
    power, count = second_filter.power, second_filter.judged
    return likelihood(second_filter.branch, power, count) - likelihood(estimate, power, count)


def has_won(
    second_filter: SecondFilter,
    estimate: Branch,
    loads: float,
    learning: EstimatorSettings,
    load: Load,
) -> bool:
    """Return whether the second filter is to be the estimate.

    Args:
        second_filter: As it has predicted.
        estimate: As it has predicted.
        loads: Changes of the load that were found lately; each makes another one less credible.
        learning: Scales and bounds.
        load: Order and structure.
    """
    if second_filter.samples == 0 or not lead(second_filter, estimate) >= _PROOF + RARER * loads:
        return False
    return is_possible(second_filter.branch.theta, learning, load)


# A second estimate for a disturbance that never rests: the bias of its model is a random walk.

_WALK = 30.0
"""Random walk of the bias in σ for each slow period: the last sample says nearly all of it."""

_RATE = 1.0 / FEWEST
"""Rate of the medians, a factor of 2 in 4 samples: a start with another load is soon forgotten."""

_LEAD = 2.0 * CLEAR
"""Λ from which it is in force, twice what decides between estimates whose noise is known: a swing
has 90 to 110, noise of 5 % after a change up to 40."""


@dataclass(slots=True)
class IncrementalModel:
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


def applies(learning: EstimatorSettings) -> bool:
    """Return whether a model has a bias that may walk; the EMF of a battery walks already."""
    return learning.bias and not learning.charge


def restart(incremental: IncrementalModel) -> None:
    """Compare anew."""
    incremental.samples = 0
    incremental.lead = incremental.residual_power = incremental.residual_weight = 0.0
    incremental.in_force = False


def follow_incremental(
    incremental: IncrementalModel,
    learning: EstimatorSettings,
    load: Load,
    sample: Observation,
    estimate: Branch,
) -> None:
    """Let the second estimate predict and learn a sample, and compare.

    Args:
        incremental: Overwritten; it begins where the other estimate is.
        learning: Forgetting and gate.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
        estimate: The estimate whose bias rests, which has predicted the sample.
    """
    if not applies(learning):
        return
    branch, rho = incremental.branch, learning.forgetting
    if incremental.samples == 0:
        copy_estimate(branch, estimate)
        restart(incremental)
    squared = rls.normalised(estimate.excitation, estimate.innovation, rho)
    predict_sample(branch, learning, load, sample)
    own = squared_error(branch, rho)
    least = max(NOISE_FLOOR, sample.rounding**2)  # below it better predictions show nothing
    incremental.samples += 1
    if incremental.samples > WINDOW:
        gain = _loss(squared, estimate.excitation / rho, incremental.other, least)
        gain -= _loss(own, branch.excitation / rho, incremental.power, least)
        incremental.lead += gain - incremental.lead / MEMORY
    _follow_noise(incremental, own, squared)
    if own > (DRIFT + THRESHOLD) * incremental.power:
        widen_last(branch, branch.innovation * branch.innovation / incremental.power)
    theta, regressor, target = branch.theta, sample.regressor, sample.target
    upper, diagonal = branch.upper, branch.diagonal
    rls.update_beside(theta, upper, diagonal, regressor, target, rho, learning.gate, 1)
    widen_last(branch, _WALK * _WALK)
    incremental.residual_power = rho * incremental.residual_power + own
    incremental.residual_weight = rho * incremental.residual_weight + 1.0


def _follow_noise(incremental: IncrementalModel, own: float, squared: float) -> None:
    """Let the medians follow a sample, and choose the estimate in force."""
    if incremental.samples == 1:
        incremental.power, incremental.other = own, squared
    least = NOISE_FLOOR / (_WALK * _WALK)
    incremental.power = max(least, move_median(incremental.power, own, _RATE))
    incremental.other = max(least, move_median(incremental.other, squared, _RATE))
    incremental.in_force = incremental.lead > (0.0 if incremental.in_force else _LEAD)


def _loss(squared: float, excitation: float, power: float, least: float) -> float:
    """Return l: minus the logarithm of the likelihood of a sample, up to a constant."""
    spread = 1.0 + excitation
    variance = max(least, power * spread)
    return 0.5 * (math.log(variance) + min(squared * spread / variance, DRIFT + THRESHOLD))
