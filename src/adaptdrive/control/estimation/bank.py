"""A bank of models: what has changed, decided by how well each explanation predicts.

An alarm (`change`) shows that something has changed, and not what. The most probable branch then
splits: it goes on as if nothing had changed, and children assume that since the last sample a
disturbance of the input has begun, that the load is another, or both with another gain and state.
Every branch predicts each sample before it learns it, and the logarithm of its probability moves by

    -1/2 (ln(1 + rᵀPr/ρ) + min(z², outlier))        z² = ε² ρ / ((ρ + rᵀPr) σ²)

less, for a child, the odds against such a change. The first term is the price of an explanation
that fits anything. The most probable branch is the estimate; improbable ones end. Adaptive
forgetting through multiple models: P. Andersson, Int. J. Control 42, 1985,
doi:10.1080/00207178508933420; F. Gustafsson, Adaptive Filtering and Change Detection, 2000,
chapter 7.

Least squares take what acts with the input as a constant that jumps now and then. A torque that
swings is neither: its residuals are coloured, and dynamics that fit them come out. With

    y = rᵀθ + e       bias[k + 1] = bias[k] + w       σ_w = 30 σ_e

the noise of the model is incremental noise (Clarke, Mohtadi and Tuffs, Automatica 23, 1987,
doi:10.1016/0005-1098(87)90087-2), and only changes from sample to sample teach the dynamics. Such
an estimate withstands any slow disturbance, and learns less from each sample than one whose bias
rests. Which of the two describes the drive is seen from how well they predict:

    Λ <- (1 - 1/60) Λ + l - l_w      l = 1/2 (ln s² + min(ε²/s², 12))

with s² = σ² (1 + rᵀPr/ρ) and σ² from the median of ε² ρ/(ρ + rᵀPr), so that a sudden change, which
the bank deals with, counts little. A bias that rests pays the odds against each disturbance that
the bank has to assume. The incremental model is in force from Λ > 20 to Λ < 0.
"""

import math
from dataclasses import dataclass

from adaptdrive.control import thresholds
from adaptdrive.control.estimation import change, rls
from adaptdrive.control.estimation.branch import (
    Branch,
    Observation,
    copy_estimate,
    learn_sample,
    new_branch,
    predict_sample,
    squared_error,
    teaches,
    widen_last,
)
from adaptdrive.control.estimation.regression import fill_initial_state
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import EstimatorSettings

# The bank: branches that split at an alarm.

_ROOM = 12
"""Most branches that are followed: those of three alarms in a row, none of them decided yet."""

_OUTLIER = 30.0
"""Largest z² that counts, 5.5 σ: a sample that is worse than that is bad for every branch."""

_LEAD = 3.0
"""Lead from which another branch becomes the estimate: odds of 20 to 1."""


@dataclass(slots=True)
class Bank:
    """The branches, and the sample at which they may split.

    Attributes:
        branches: All that are followed, the estimate among them.
        estimate: The one that is believed.
        point: The last sample.
    """

    branches: list[Branch]
    estimate: Branch
    point: change.ChangePoint


def new_bank(count: int) -> Bank:
    """Return a bank of one branch for θ of a length."""
    estimate = new_branch(count)
    return Bank([estimate], estimate, change.ChangePoint([0.0] * count, [0.0] * count))


def learn_branches(
    bank: Bank,
    detector: change.ChangeDetector,
    learning: EstimatorSettings,
    load: Load,
    sample: Observation,
) -> bool:
    """Let every branch predict and learn a sample.

    Args:
        bank: Overwritten; its estimate has predicted the sample.
        detector: Overwritten.
        learning: Scales, forgetting and gate.
        load: Order and structure.
        sample: The functions of the initial state in it are those of the estimate afterwards.

    Returns:
        Whether another branch has become the estimate.
    """
    power = change.noise_power(detector, sample.rounding)
    for one in bank.branches:
        if one is not bank.estimate:
            predict_sample(one, learning, load, sample)
        one.score += _likelihood(one, power, learning.forgetting)
        one.age += 1
    best = _most_probable(bank)
    if change.is_change(detector, squared_error(best, learning.forgetting), power):
        bank.point.power, bank.point.gap_s = power, sample.time_s - bank.point.time_s
        _split(bank, best, learning, load, sample)
    for one in bank.branches:
        if teaches(one, learning):
            fill_initial_state(sample.regressor, learning, load, sample.time_s - one.origin_s)
            learn_sample(one, sample, learning, learning.gate)
    another = _choose(bank)
    since_s = sample.time_s - bank.estimate.origin_s
    fill_initial_state(sample.regressor, learning, load, since_s)
    change.note_sample(bank.point, sample)
    return another


def _likelihood(branch: Branch, power: float, forgetting: float) -> float:
    """Return the logarithm of the likelihood of the last prediction, up to a constant."""
    squared = squared_error(branch, forgetting) / power
    return -0.5 * (math.log(1.0 + branch.excitation / forgetting) + min(squared, _OUTLIER))


def _most_probable(bank: Bank) -> Branch:
    best = bank.estimate
    for one in bank.branches:
        if one.score > best.score:
            best = one
    return best


def _split(
    bank: Bank, parent: Branch, learning: EstimatorSettings, load: Load, sample: Observation
) -> None:
    """Add a child of a branch for each kind of change; each predicts the sample too."""
    power, rho = bank.point.power, learning.forgetting
    before = parent.score - _likelihood(parent, power, rho)
    for kind, odds in change.ODDS_AGAINST.items():
        child = new_branch(len(parent.theta))
        child.kind = kind
        copy_estimate(child, parent)
        change.restart_past(child, learning, load, bank.point.time_s)
        change.widen(child, kind, learning, load, bank.point)
        predict_sample(child, learning, load, sample)
        child.score = before - odds + _likelihood(child, power, rho)
        bank.branches.append(child)


def _choose(bank: Bank) -> bool:
    """Make the most probable branch the estimate if it is clearly ahead; end improbable ones."""
    best, believed = _most_probable(bank), bank.estimate
    if best.score - believed.score > _LEAD:
        bank.estimate = best
        believed.age = 0  # only clear odds end what was the estimate
    top = best.score
    for one in bank.branches:
        one.score -= top
    bank.branches = [one for one in bank.branches if one is bank.estimate or _is_possible(one)]
    while len(bank.branches) > _ROOM:
        _drop_least_probable(bank)
    return bank.estimate is not believed


def _is_possible(branch: Branch) -> bool:
    """Return whether a branch may still become the estimate."""
    if branch.age <= thresholds.EARLIEST:
        return True
    return branch.score > -thresholds.CLEAR and branch.age <= thresholds.LIFE


def _drop_least_probable(bank: Bank) -> None:
    others = [one for one in bank.branches if one is not bank.estimate]
    worst = min(others, key=lambda one: one.score)
    bank.branches = [one for one in bank.branches if one is not worst]


def is_contested(bank: Bank) -> bool:
    """Return whether another branch than the estimate may be right: a young or a probable one."""
    return any(
        one is not bank.estimate and (one.age < thresholds.EARLIEST or one.score > -_LEAD)
        for one in bank.branches
    )


# The incremental model: its bias is a random walk, for a disturbance that never rests.

_WALK = 30.0
"""Random walk of the bias in σ for each slow period: the last sample says nearly all of it."""

_RATE = 1.0 / thresholds.FEWEST
"""Rate of the medians, a factor of 2 in 4 samples: a start with another load is soon forgotten."""

_SWINGING = 2.0 * thresholds.CLEAR
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
    power: float = thresholds.NOISE_FLOOR
    other: float = thresholds.NOISE_FLOOR
    lead: float = 0.0
    samples: int = 0
    in_force: bool = False
    residual_power: float = 0.0
    residual_weight: float = 0.0


def applies(learning: EstimatorSettings) -> bool:
    """Return whether a model has a bias that may walk; the EMF of a battery walks already."""
    return learning.bias and not learning.charge


def restart(incremental: IncrementalModel) -> None:
    """Begin at the estimate whose bias rests, and compare anew."""
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
    squared = squared_error(estimate, rho)
    predict_sample(branch, learning, load, sample)
    own = squared_error(branch, rho)
    # below it better predictions show nothing
    least = max(thresholds.NOISE_FLOOR, sample.rounding**2)
    incremental.samples += 1
    if incremental.samples > thresholds.WINDOW:
        gain = _loss(squared, estimate.excitation / rho, incremental.other, least)
        gain -= _loss(own, branch.excitation / rho, incremental.power, least)
        incremental.lead += gain - incremental.lead / thresholds.MEMORY
    _follow_noise(incremental, own, squared)
    if own > (change.DRIFT + change.THRESHOLD) * incremental.power:
        widen_last(branch, branch.innovation * branch.innovation / incremental.power)
    theta, regressor, target = branch.theta, sample.regressor, sample.target
    upper, diagonal = branch.upper, branch.diagonal
    rls.update_beside(theta, upper, diagonal, regressor, target, rho, learning.gate, 1)
    widen_last(branch, _WALK * _WALK)
    incremental.residual_power = rho * incremental.residual_power + own
    incremental.residual_weight = rho * incremental.residual_weight + 1.0


def charge_disturbance(incremental: IncrementalModel, estimate: Branch) -> None:
    """Charge a bias that rests for a disturbance that it had to assume: it is as rare as its odds.

    Args:
        incremental: Λ is overwritten.
        estimate: The branch that has just become the estimate.
    """
    if estimate.kind == change.DISTURBANCE:
        incremental.lead += thresholds.RARE


def _follow_noise(incremental: IncrementalModel, own: float, squared: float) -> None:
    """Let the medians follow a sample, and choose the estimate in force."""
    if incremental.samples == 1:
        incremental.power, incremental.other = own, squared
    least = thresholds.NOISE_FLOOR / (_WALK * _WALK)
    incremental.power = max(least, change.move_median(incremental.power, own, _RATE))
    incremental.other = max(least, change.move_median(incremental.other, squared, _RATE))
    incremental.in_force = incremental.lead > (0.0 if incremental.in_force else _SWINGING)


def _loss(squared: float, excitation: float, power: float, least: float) -> float:
    """Return l: minus the logarithm of the likelihood of a sample, up to a constant."""
    spread = 1.0 + excitation
    variance = max(least, power * spread)
    ratio = min(squared * spread / variance, change.DRIFT + change.THRESHOLD)
    return 0.5 * (math.log(variance) + ratio)
