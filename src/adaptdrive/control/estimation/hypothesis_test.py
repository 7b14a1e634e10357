"""Detection of an abrupt change, and rival explanations of it on the samples since.

The normalised innovation z² = ε² ρ / ((ρ + rᵀPr) σ²) of a settled estimate is about 1. A one-sided
cumulative sum (E. S. Page, Biometrika 41, 1954, doi:10.1093/biomet/41.1-2.100)

    S <- max(0, S + z² - drift)          alarm when S > threshold, S = 0 after it

stays at 0 then, and reaches the threshold within a few samples of a change. The last sample at
which it was 0 is Page's estimate of the change. σ² follows the median of z² σ², which is 0.455 of
the mean for Gaussian noise: a change moves it hardly, however large it is. It has a floor against
rounding and model error.

While an estimate is new, its innovations are a poor measure of σ². The noise of a sample shows in
their second differences, (ε[k] - 2 ε[k-1] + ε[k-2])² / 6 on average, whatever slow error is
under it.

An alarm shows that something has changed, and not what. The estimate goes back to the last sample
before the change, and four explanations take in the samples since then, each with its
estimate: nothing; a disturbance of the input; another load; both (`hypotheses`). Their likelihoods
L (`branch`) are compared, less a handicap for what is rare. The sum of logarithms in L is the price
of an explanation that fits anything. The likeliest is the estimate from the alarm on, and stays
when it has won.
"""

import math
from dataclasses import dataclass

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.estimation import covariance, regression
from adaptdrive.control.estimation.branch import (
    Branch,
    Observation,
    copy_estimate,
    count_prediction,
    learn_sample,
    likelihood,
    new_branch,
    posterior_power,
    predict_sample,
    squared_error,
)
from adaptdrive.control.loads.load import Load, is_damped
from adaptdrive.control.settings import EstimatorSettings
from adaptdrive.control.vectors import Vector

# Detection of an abrupt change of the load from the innovations of the estimator.

DRIFT = 3.0
"""Subtracted from each z²: the sum rises only while z² is larger than three times its mean."""

THRESHOLD = 9.0
"""One z² above 12, or several smaller ones in a row: rare with noise alone."""

_FAST_RATE = 0.3
"""Rate of the median after a start: within a factor of 2 after about 3 samples."""

_SLOW_RATE = 0.03
"""Rate of the median later: a factor of 2 takes 25 samples, longer than a comparison."""

_MEDIAN = 0.455
"""Median over mean of the square of Gaussian noise (χ² with one degree of freedom)."""

LEAST_NOISE = 1e-2 * thresholds.NOISE_FLOOR
"""Least mean square of noise that is followed: a tenth of the deviation that explanations count."""


@dataclass(slots=True)
class ChangeDetector:
    """State of the detector of abrupt changes.

    Attributes:
        power: σ², of the innovations in units of the scaled output.
        sum: S.
        samples: Samples seen.
        alarms: Alarms so far.
        noise: Mean square of the noise of a sample, from second differences.
        last: ε of the last sample.
        slope: Difference of the last two.
    """

    power: float = 0.0
    sum: float = 0.0
    samples: int = 0
    alarms: int = 0
    noise: float = thresholds.NOISE_FLOOR
    last: float = 0.0
    slope: float = 0.0


def is_change(state: ChangeDetector, squared: float) -> bool:
    """Return whether the load has just changed.

    Args:
        state: Overwritten.
        squared: ε² ρ / (ρ + rᵀPr), scaled.
    """
    state.samples += 1
    if state.samples <= thresholds.WINDOW:
        state.power = max(thresholds.NOISE_FLOOR, state.noise)
        return False
    ratio = squared / state.power
    state.power = max(thresholds.NOISE_FLOOR, move_median(state.power, squared, _SLOW_RATE))
    state.sum = max(0.0, state.sum + ratio - DRIFT)
    if state.sum <= THRESHOLD:
        return False
    state.sum = 0.0
    state.alarms += 1
    return True


def track_noise(state: ChangeDetector, innovation: float) -> None:
    """Follow the noise of a sample, which no slow error hides.

    Args:
        state: Overwritten.
        innovation: ε, scaled.
    """
    slope = innovation - state.last
    bend = slope - state.slope
    squared = bend * bend / 6.0  # a power would raise where it overflows
    state.last, state.slope = innovation, slope
    rate = _FAST_RATE if state.samples <= thresholds.WINDOW else _SLOW_RATE
    state.noise = max(LEAST_NOISE, move_median(state.noise, squared, rate))


def move_median(power: float, squared: float, rate: float) -> float:
    """Move a mean square so that its median is that of Gaussian noise."""
    return power * (1.0 + (rate if squared > _MEDIAN * power else -rate))


# Rival explanations of an alarm, on the samples since the change.

ROOM = thresholds.EARLIEST + 1
"""Samples that can be kept: ten that may be the first after a change, and the one that shows it."""

_PROOF = 8.0
"""Lead over `nothing` that any other explanation needs: odds of 3,000 to 1."""


@dataclass(slots=True)
class Hypotheses:
    """The explanations, and the samples from which they can start.

    Attributes:
        calm: The estimate at the anchor.
        branches: The explanations, by their kinds.
        anchor: The last sample before the change, while nothing changes the last one.
        lowered: r of the last sample with every power of λ lowered by one.
        kept: The samples since the anchor.
        waiting: How many they are.
        samples: Samples that the explanations have taken in; 0 when nothing is to be explained.
        kind: The likeliest explanation, of the last alarm when nothing is to be explained.
        loads: Changes of the load that were found, forgotten with time.
        offset: Offset of the input at the alarm, over the input's scale.
        moved: Sum of the squares of its changes by disturbances that were found, forgotten alike.
    """

    calm: Branch
    branches: list[Branch]
    anchor: covariance.Anchor
    lowered: Vector
    kept: list[Observation]
    waiting: int = 0
    samples: int = 0
    kind: int = covariance.NOTHING
    loads: float = 0.0
    offset: float = 0.0
    moved: float = 0.0


def new_hypotheses(count: int) -> Hypotheses:
    """Explanations for θ of a length."""
    return Hypotheses(
        calm=new_branch(count),
        branches=[new_branch(count) for _ in range(covariance.NOTHING, covariance.BOTH + 1)],
        anchor=covariance.Anchor([0.0] * count, [0.0] * count),
        lowered=[0.0] * count,
        kept=[Observation([0.0] * count) for _ in range(ROOM)],
    )


def forget_changes(hypotheses: Hypotheses) -> None:
    """Let a slow period pass."""
    hypotheses.loads *= 1.0 - 1.0 / thresholds.LIFE
    hypotheses.moved *= 1.0 - 1.0 / thresholds.LIFE


def note_disturbance(hypotheses: Hypotheses, offset: float) -> None:
    """Remember the size of a disturbance that was found.

    Args:
        hypotheses: Overwritten.
        offset: Offset of the input with it, over the input's scale; NaN for an unknown one.
    """
    moved = offset - hypotheses.offset
    if math.isfinite(moved):
        hypotheses.moved += moved * moved


def drop_anchor(hypotheses: Hypotheses, estimate: Branch, sample: Observation) -> None:
    """Remember the estimate of now, after a sample that did not detector."""
    copy_estimate(hypotheses.calm, estimate)
    vectors.copy_into(hypotheses.anchor.regressor, sample.regressor)
    vectors.copy_into(hypotheses.anchor.lowered, hypotheses.lowered)
    hypotheses.anchor.time_s = sample.time_s
    hypotheses.waiting = 0


def keep_sample(hypotheses: Hypotheses, sample: Observation, room: int) -> bool:
    """Keep a sample that may be the first after a change; False when so many are kept already."""
    if hypotheses.waiting >= room:
        return False
    kept = hypotheses.kept[hypotheses.waiting]
    vectors.copy_into(kept.regressor, sample.regressor)
    kept.target, kept.time_s = sample.target, sample.time_s
    hypotheses.waiting += 1
    return True


def prepare(hypotheses: Hypotheses, power: float) -> None:
    """Note at the anchor what is known of a change at an alarm.

    Args:
        hypotheses: Overwritten.
        power: σ0².
    """
    hypotheses.anchor.power = power
    hypotheses.anchor.gap_s = hypotheses.kept[0].time_s - hypotheses.anchor.time_s


def split(hypotheses: Hypotheses, learning: EstimatorSettings, load: Load, power: float) -> None:
    """After an alarm: go back to the anchor, and start every explanation from there.

    Args:
        hypotheses: Overwritten.
        learning: Scales and forgetting.
        load: Order and structure.
        power: σ0².
    """
    prepare(hypotheses, power)
    for kind, branch in enumerate(hypotheses.branches):
        copy_estimate(branch, hypotheses.calm)
        branch.squares = branch.logs = branch.score = 0.0
        if kind != covariance.NOTHING:
            covariance.restart_past(branch, learning, load, hypotheses.anchor.time_s)
            covariance.widen(branch, kind, learning, load, hypotheses.anchor)
    hypotheses.samples = 0
    for number in range(hypotheses.waiting):
        follow(hypotheses, learning, load, hypotheses.kept[number])
    hypotheses.waiting = 0


def follow(
    hypotheses: Hypotheses, learning: EstimatorSettings, load: Load, sample: Observation
) -> None:
    """Let every explanation take in a sample, and find the likeliest.

    Args:
        hypotheses: Overwritten.
        learning: Forgetting.
        load: Order.
        sample: The functions of the initial state in it are overwritten.
    """
    hypotheses.samples += 1
    power, count = hypotheses.anchor.power, hypotheses.samples
    for kind, branch in enumerate(hypotheses.branches):
        predict_sample(branch, learning, load, sample)
        count_prediction(branch, learning.forgetting)
        branch.score = likelihood(branch, power, count) - _rarity(hypotheses, kind)
        learn_sample(branch, sample, learning, 0.0)
    hypotheses.kind = _likeliest(hypotheses)
    since_s = sample.time_s - likeliest(hypotheses).origin_s
    regression.fill_initial_state(sample.regressor, learning, load, since_s)


def _rarity(hypotheses: Hypotheses, kind: int) -> float:
    """Logarithm of how much rarer than a disturbance a kind of change is.

    A load does not change again and again: what looks like that is a disturbance of another kind.
    """
    if kind < covariance.LOAD:
        return 0.0
    changes = 1.0 if kind == covariance.LOAD else 2.0
    return thresholds.RARER * (changes + hypotheses.loads)


def likeliest(hypotheses: Hypotheses) -> Branch:
    """Return the explanation in `kind`."""
    return hypotheses.branches[hypotheses.kind]


def _likeliest(hypotheses: Hypotheses) -> int:
    best = covariance.NOTHING
    for kind, branch in enumerate(hypotheses.branches):
        if branch.score > hypotheses.branches[best].score:
            best = kind
    return best


def is_clear(hypotheses: Hypotheses) -> bool:
    """Return whether the likeliest explanation has left the others behind."""
    best, rival = _likeliest(hypotheses), -math.inf
    for kind, branch in enumerate(hypotheses.branches):
        if kind != best:
            rival = max(rival, branch.score)
    return hypotheses.branches[best].score - rival > thresholds.CLEAR


def is_expected(hypotheses: Hypotheses, learning: EstimatorSettings) -> bool:
    """Return whether an explanation that has not been left behind expected the last sample."""
    least = hypotheses.branches[_likeliest(hypotheses)].score - thresholds.CLEAR
    largest, rho = DRIFT * hypotheses.anchor.power, learning.forgetting
    return any(
        one.score >= least and squared_error(one, rho) <= largest for one in hypotheses.branches
    )


def is_settled(hypotheses: Hypotheses, learning: EstimatorSettings, load: Load) -> bool:
    """Decide when the evidence suffices or time is over; the explanation is in `kind` then.

    Another explanation than `nothing` needs proof, and a load must be one that can exist.
    """
    best = _likeliest(hypotheses)
    if hypotheses.samples < thresholds.EARLIEST or (
        hypotheses.samples < thresholds.WINDOW and not is_clear(hypotheses)
    ):
        return False
    if best >= covariance.LOAD and not is_possible(hypotheses.branches[best].theta, learning, load):
        if hypotheses.samples < 2 * thresholds.WINDOW:
            return False
        best = covariance.DISTURBANCE
    if best >= covariance.LOAD and not is_clear(hypotheses):
        power = hypotheses.anchor.power
        best = (
            best
            if covariance.is_sure(hypotheses.branches[best], power, learning, load)
            else covariance.DISTURBANCE
        )
    if hypotheses.branches[best].score - hypotheses.branches[covariance.NOTHING].score < _PROOF:
        best = covariance.NOTHING
    hypotheses.kind = best
    return True


def settle(hypotheses: Hypotheses) -> None:
    """End a comparison that is under way: the explanation in `kind` is the one."""
    if hypotheses.samples > 0 and hypotheses.kind >= covariance.LOAD:
        hypotheses.loads += 1.0
    hypotheses.samples = 0


def explained_power(hypotheses: Hypotheses) -> float:
    """Return σ² as the explanation in `kind` leaves it."""
    power = posterior_power(likeliest(hypotheses), hypotheses.anchor.power, hypotheses.samples)
    return max(thresholds.NOISE_FLOOR, power)


def is_possible(theta: Vector, learning: EstimatorSettings, load: Load) -> bool:
    """Return whether such a load can exist: it stores and loses, so it neither grows nor swings."""
    _, denominator = regression.filtered_model(theta, learning, load)
    losing = all(coefficient > 0.0 for coefficient in denominator)
    return losing and is_damped(denominator, learning.damping_min)
