"""A branch: an estimate with its covariance, how well it predicts, and an offset that moves.

The bank (`bank`) holds several; the most probable one is the estimate. Least squares take every
parameter as constant, but for the forgetting. A bias that moves is no constant: between two samples
it follows a random walk, which widens P (Ljung, System Identification, section 11.2), and that is
all that is forgotten of it. With the walk a sample is uncertain by its bias most of all, so that
forgetting along P r would hardly reach the dynamics: they are forgotten separately.
"""

from dataclasses import dataclass

from adaptdrive.control import settings, thresholds, vectors
from adaptdrive.control.estimation import rls
from adaptdrive.control.estimation.regression import fill_initial_state
from adaptdrive.control.loads.load import Load
from adaptdrive.control.vectors import Vector

# A branch: an estimate with its covariance, and how well it has predicted.


@dataclass(slots=True)
class Observation:
    """One slow sample, as the estimator sees it.

    Attributes:
        regressor: r, scaled; the functions of the initial state in it belong to the branch that
            has predicted it last.
        lowered: r with every power of λ lowered by one.
        target: What r predicts, scaled.
        time_s: Time since start.
        rounding: Standard deviation of the rounding error of the output, scaled.
    """

    regressor: Vector
    lowered: Vector
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
        score: Logarithm of its probability over that of the most probable branch.
        age: Samples since it was split off.
        kind: Kind of change that it assumes (`change`), 0 for none.
        innovation: ε of the last sample, scaled.
        excitation: rᵀPr of the last sample.
    """

    theta: Vector
    upper: Vector
    diagonal: Vector
    origin_s: float = 0.0
    score: float = 0.0
    age: int = 0
    kind: int = 0
    innovation: float = 0.0
    excitation: float = 0.0


def new_branch(count: int) -> Branch:
    """Return a branch for θ of a length."""
    return Branch([0.0] * count, [0.0] * (count * count), [0.0] * count)


def copy_estimate(target: Branch, source: Branch) -> None:
    """Overwrite θ, P, origin and the last prediction."""
    vectors.copy_into(target.theta, source.theta)
    vectors.copy_into(target.upper, source.upper)
    vectors.copy_into(target.diagonal, source.diagonal)
    target.origin_s = source.origin_s
    target.innovation, target.excitation = source.innovation, source.excitation


def predict(branch: Branch, sample: Observation) -> None:
    """Predict a sample, before it is learnt: innovation and excitation are overwritten."""
    branch.excitation = rls.excitation(branch.upper, branch.diagonal, sample.regressor)
    branch.innovation = sample.target - rls.predict(branch.theta, sample.regressor)


def predict_sample(
    branch: Branch, learning: settings.EstimatorSettings, load: Load, sample: Observation
) -> None:
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
    """Return ε² of the last prediction less what the uncertainty of θ adds."""
    return normalised(branch.innovation, branch.excitation, forgetting)


def normalised(innovation: float, excitation: float, forgetting: float) -> float:
    """Return ε² ρ/(ρ + rᵀPr)."""
    return innovation * innovation * (forgetting / (forgetting + excitation))


def teaches(branch: Branch, learning: settings.EstimatorSettings) -> bool:
    """Return whether the last predicted sample shows more than what is forgotten with it."""
    return branch.excitation > learning.gate * (1.0 - learning.forgetting)


def widen_last(branch: Branch, variance: float) -> None:
    """Widen P along the last parameter, the bias."""
    direction = vectors.unit(len(branch.theta), len(branch.theta) - 1)
    rls.widen(branch.upper, branch.diagonal, direction, variance)


# An offset that moves: the EMF of a battery, the inflow temperature of a bath.

OFFSET_WALK = 1.0 / thresholds.WINDOW
"""Random walk of an offset that drifts, in σ for each slow period: it is a mean over a window."""


def walking_count(learning: settings.EstimatorSettings) -> int:
    """Return how many parameters, the last ones of θ, follow a random walk."""
    if not learning.bias:
        return 0
    if learning.charge:
        return 2
    return 1 if learning.drifts else 0


def learn_sample(
    branch: Branch, sample: Observation, learning: settings.EstimatorSettings, gate: float
) -> None:
    """Take in one sample, with directional forgetting of what does not walk.

    The walk of a charge is in `estimator.widen_emf`.

    Args:
        branch: θ and P, overwritten.
        sample: r and what it predicts.
        learning: Forgetting, and what walks.
        gate: Gate below which a sample moves only what walks.
    """
    theta, upper, diagonal = branch.theta, branch.upper, branch.diagonal
    regressor, target, rho = sample.regressor, sample.target, learning.forgetting
    walks = walking_count(learning)
    if walks == 0:
        rls.update_along(theta, upper, diagonal, regressor, target, rho)
        return
    rls.update_beside(theta, upper, diagonal, regressor, target, rho, gate, walks)
    if not learning.charge:
        widen_last(branch, OFFSET_WALK * OFFSET_WALK)
