"""A second estimate for a disturbance that never rests: the bias of its model is a random walk.

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

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control import rls
from adaptdrive.control.branch import (
    Branch,
    Datum,
    copy_estimate,
    predict_sample,
    squared_error,
    widen_last,
)
from adaptdrive.control.evidence import CLEAR, FEWEST, MEMORY, NOISE_FLOOR, WINDOW
from adaptdrive.control.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.surprise import DRIFT, THRESHOLD, move_median

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


def follow(
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
