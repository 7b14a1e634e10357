"""Rival explanations of an alarm, on the samples since the change.

An alarm shows that something has changed, and not what. The estimate goes back to the last sample
before the change, and four explanations take in the samples since then, each with an estimate of
its own: nothing; a disturbance of the input; another load; both (`hypotheses`). With σ² known
only as σ0² from ν0 samples their likelihoods are, up to a constant (Bayesian linear regression
with an inverse-gamma prior of σ²; Gelman et al., Bayesian Data Analysis, chapter 14),

    L = -1/2 Σ ln(1 + rᵀPr/ρ) - (ν0 + n)/2 ln(1 + (Σ ε² ρ/(ρ + rᵀPr) - n σ0²) / ((ν0 + n) σ0²))

The first sum is the price of an explanation that fits anything. The likeliest is the estimate from
the alarm on, and stays when it has won.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.certainty import is_sure
from adaptdrive.control.drift import learn_sample
from adaptdrive.control.evidence import CLEAR, EARLIEST, LIFE, NOISE_FLOOR, RARER, WINDOW
from adaptdrive.control.hypotheses import (
    BOTH,
    DISTURBANCE,
    LOAD,
    NOTHING,
    Anchor,
    Branch,
    copy_estimate,
    count_prediction,
    new_branch,
    predict_sample,
    restart_past,
    squared_error,
    widen,
)
from adaptdrive.control.load import Load
from adaptdrive.control.regression import fill_initial_state, filtered_model
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import DRIFT
from adaptdrive.control.vectors import Vector, copy_into

ROOM = EARLIEST + 1
"""Samples that can be kept: ten that may be the first after a change, and the one that shows it."""

PRIOR_SAMPLES = 4.0
"""Weight of σ0²: as little as leaves the likelihood finite variance."""

_PROOF = 8.0
"""Lead over `nothing` that any other explanation needs: odds of 3,000 to 1."""


@dataclass(slots=True)
class Rivals:
    """The explanations, and the samples from which they can start.

    Attributes:
        now: The estimate after the last sample.
        calm: The estimate at the anchor.
        nothing: Explanation.
        disturbance: Explanation.
        load: Explanation.
        both: Explanation.
        anchor: The last sample before the change, while nothing changes the last one.
        lowered: r of the last sample with every power of λ lowered by one.
        regressors: r of the samples since the anchor.
        targets: What r predicts, likewise.
        times_s: When they were taken.
        waiting: How many they are.
        samples: Samples that the explanations have taken in; 0 when nothing is to be explained.
        kind: The likeliest explanation, of the last alarm when nothing is to be explained.
        loads: Changes of the load that were found, forgotten with time.
        offset: Offset of the input at the alarm, over the input's scale.
        moved: Sum of the squares of its changes by disturbances that were found, forgotten alike.
    """

    now: Branch
    calm: Branch
    nothing: Branch
    disturbance: Branch
    load: Branch
    both: Branch
    anchor: Anchor
    lowered: Vector
    regressors: Vector
    targets: Vector
    times_s: Vector
    waiting: int = 0
    samples: int = 0
    kind: int = NOTHING
    loads: float = 0.0
    offset: float = 0.0
    moved: float = 0.0


def new_rivals(count: int) -> Rivals:
    """Explanations for θ of a length."""
    return Rivals(
        now=new_branch(count),
        calm=new_branch(count),
        nothing=new_branch(count),
        disturbance=new_branch(count),
        load=new_branch(count),
        both=new_branch(count),
        anchor=Anchor([0.0] * count, [0.0] * count),
        lowered=[0.0] * count,
        regressors=[0.0] * (ROOM * count),
        targets=[0.0] * ROOM,
        times_s=[0.0] * ROOM,
    )


def forget_changes(rivals: Rivals) -> None:
    """Let a slow period pass."""
    rivals.loads *= 1.0 - 1.0 / LIFE
    rivals.moved *= 1.0 - 1.0 / LIFE


def note_disturbance(rivals: Rivals, offset: float) -> None:
    """Remember the size of a disturbance that was found.

    Args:
        rivals: Overwritten.
        offset: Offset of the input with it, over the input's scale; NaN for an unknown one.
    """
    moved = offset - rivals.offset
    if math.isfinite(moved):
        rivals.moved += moved * moved


def drop_anchor(rivals: Rivals, regressor: Vector, time_s: float) -> None:
    """Remember the estimate of now, after a sample that did not surprise."""
    copy_estimate(rivals.calm, rivals.now)
    copy_into(rivals.anchor.regressor, regressor)
    copy_into(rivals.anchor.lowered, rivals.lowered)
    rivals.anchor.time_s = time_s
    rivals.waiting = 0


def keep_sample(rivals: Rivals, regressor: Vector, target: float, time_s: float, room: int) -> bool:
    """Keep a sample that may be the first after a change; False when so many are kept already."""
    if rivals.waiting >= room:
        return False
    count = len(regressor)
    for i in range(count):
        rivals.regressors[rivals.waiting * count + i] = regressor[i]
    rivals.targets[rivals.waiting] = target
    rivals.times_s[rivals.waiting] = time_s
    rivals.waiting += 1
    return True


def prepare(rivals: Rivals, power: float) -> None:
    """Note at the anchor what is known of a change at an alarm.

    Args:
        rivals: Overwritten.
        power: σ0².
    """
    rivals.anchor.power = power
    rivals.anchor.gap_s = rivals.times_s[0] - rivals.anchor.time_s


def split(rivals: Rivals, learning: Learning, load: Load, power: float) -> None:
    """After an alarm: go back to the anchor, and start every explanation from there.

    Args:
        rivals: Overwritten.
        learning: Scales and forgetting.
        load: Order and structure.
        power: σ0².
    """
    prepare(rivals, power)
    for kind in range(NOTHING, BOTH + 1):
        _begin(rivals, branch_of(rivals, kind), kind, learning, load)
    count = len(rivals.calm.theta)
    regressor = [0.0] * count
    rivals.samples = 0
    for number in range(rivals.waiting):
        for i in range(count):
            regressor[i] = rivals.regressors[number * count + i]
        follow(rivals, learning, load, regressor, rivals.targets[number], rivals.times_s[number])
    rivals.waiting = 0


def _begin(rivals: Rivals, branch: Branch, kind: int, learning: Learning, load: Load) -> None:
    copy_estimate(branch, rivals.calm)
    branch.squares = branch.logs = branch.score = 0.0
    if kind != NOTHING:
        restart_past(branch, learning, load, rivals.anchor.time_s)
        widen(branch, kind, learning, load, rivals.anchor)


def follow(
    rivals: Rivals, learning: Learning, load: Load, regressor: Vector, target: float, time_s: float
) -> None:
    """Let every explanation take in a sample, and find the likeliest.

    Args:
        rivals: Overwritten.
        learning: Forgetting.
        load: Order.
        regressor: r; the functions of the initial state in it are overwritten.
        target: What r predicts, scaled.
        time_s: When it was taken.
    """
    rivals.samples += 1
    for kind in range(NOTHING, BOTH + 1):
        branch = branch_of(rivals, kind)
        _take_in(rivals, branch, kind, learning, load, regressor, target, time_s)
    rivals.kind = _likeliest(rivals)
    fill_initial_state(regressor, learning, load, time_s - branch_of(rivals, rivals.kind).origin_s)


def _take_in(
    rivals: Rivals,
    branch: Branch,
    kind: int,
    learning: Learning,
    load: Load,
    regressor: Vector,
    target: float,
    time_s: float,
) -> None:
    forgetting, power = learning.forgetting, rivals.anchor.power
    predict_sample(branch, learning, load, regressor, target, time_s)
    count_prediction(branch, forgetting)
    weight = PRIOR_SAMPLES + rivals.samples
    mean = (PRIOR_SAMPLES * power + branch.squares) / power
    branch.score = -0.5 * (branch.logs + weight * math.log(mean / weight)) - _rarity(rivals, kind)
    learn_sample(branch.theta, branch.upper, branch.diagonal, regressor, target, learning, 0.0)


def _rarity(rivals: Rivals, kind: int) -> float:
    """Logarithm of how much rarer than a disturbance a kind of change is.

    A load does not change again and again: what looks like that is a disturbance of another kind.
    """
    if kind < LOAD:
        return 0.0
    changes = 1.0 if kind == LOAD else 2.0
    return RARER * (changes + rivals.loads)


def branch_of(rivals: Rivals, kind: int) -> Branch:
    """Return the explanation of a kind."""
    if kind == DISTURBANCE:
        return rivals.disturbance
    if kind == LOAD:
        return rivals.load
    if kind == BOTH:
        return rivals.both
    return rivals.nothing


def _likeliest(rivals: Rivals) -> int:
    best = NOTHING
    for kind in (DISTURBANCE, LOAD, BOTH):
        if branch_of(rivals, kind).score > branch_of(rivals, best).score:
            best = kind
    return best


def is_clear(rivals: Rivals) -> bool:
    """Return whether the likeliest explanation has left the others behind."""
    best = _likeliest(rivals)
    rival = -math.inf
    for kind in range(NOTHING, BOTH + 1):
        if kind != best:
            rival = max(rival, branch_of(rivals, kind).score)
    return branch_of(rivals, best).score - rival > CLEAR


def is_expected(rivals: Rivals, learning: Learning) -> bool:
    """Return whether an explanation that has not been left behind expected the last sample."""
    least = branch_of(rivals, _likeliest(rivals)).score - CLEAR
    largest = DRIFT * rivals.anchor.power
    for kind in range(NOTHING, BOTH + 1):
        branch = branch_of(rivals, kind)
        if branch.score >= least and squared_error(branch, learning.forgetting) <= largest:
            return True
    return False


def is_settled(rivals: Rivals, learning: Learning, load: Load) -> bool:
    """Decide when the evidence suffices or time is over; the explanation is in `kind` then.

    Another explanation than `nothing` needs proof, and a load must be one that can exist.
    """
    best = _likeliest(rivals)
    if rivals.samples < EARLIEST or (rivals.samples < WINDOW and not is_clear(rivals)):
        return False
    if best >= LOAD and not is_possible(branch_of(rivals, best).theta, learning, load):
        if rivals.samples < 2 * WINDOW:
            return False
        best = DISTURBANCE
    if best >= LOAD and not is_clear(rivals) and not _is_sure(rivals, best, learning, load):
        best = DISTURBANCE
    if branch_of(rivals, best).score - rivals.nothing.score < _PROOF:
        best = NOTHING
    rivals.kind = best
    return True


def _is_sure(rivals: Rivals, kind: int, learning: Learning, load: Load) -> bool:
    branch, power = branch_of(rivals, kind), rivals.anchor.power
    return is_sure(branch.theta, branch.upper, branch.diagonal, power, learning, load)


def settle(rivals: Rivals) -> None:
    """End a comparison that is under way: the explanation in `kind` is the one."""
    if rivals.samples > 0 and rivals.kind >= LOAD:
        rivals.loads += 1.0
    rivals.samples = 0


def posterior_power(rivals: Rivals) -> float:
    """Return σ² as the explanation in `kind` leaves it."""
    squares = branch_of(rivals, rivals.kind).squares
    weight = PRIOR_SAMPLES + rivals.samples
    return max(NOISE_FLOOR, (PRIOR_SAMPLES * rivals.anchor.power + squares) / weight)


def is_possible(theta: Vector, learning: Learning, load: Load) -> bool:
    """Return whether such a load can exist: it stores and loses, so it neither grows nor swings."""
    _, denominator = filtered_model(theta, learning, load)
    for coefficient in denominator:
        if not coefficient > 0.0:
            return False
    if len(denominator) != 3:
        return True
    least = 4.0 * learning.damping_min * learning.damping_min * denominator[2]
    return denominator[1] * denominator[1] >= least
