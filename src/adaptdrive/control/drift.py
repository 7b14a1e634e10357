"""Learning with an offset that moves: the EMF of a battery, the inflow temperature of a bath.

Least squares take every parameter as constant, but for the forgetting. A bias that moves is no
constant: between two samples it follows a random walk, which widens P (Ljung, System
Identification, section 11.2), and that is all that is forgotten of it. With the walk a sample is
uncertain by its bias most of all, so that forgetting along P r would hardly reach the dynamics:
they are forgotten separately.
"""

from __future__ import annotations

from adaptdrive.control import rls
from adaptdrive.control.branch import Branch, Datum, widen_last
from adaptdrive.control.evidence import WINDOW
from adaptdrive.control.settings import Learning

OFFSET_WALK = 1.0 / WINDOW
"""Random walk of an offset that drifts, in σ for each slow period: it is a mean over a window."""


def walking_count(learning: Learning) -> int:
    """Return how many parameters, the last ones of θ, follow a random walk."""
    if not learning.bias:
        return 0
    if learning.charge:
        return 2
    return 1 if learning.drifts else 0


def learn_sample(branch: Branch, sample: Datum, learning: Learning, gate: float) -> None:
    """Take in one sample, with directional forgetting of what does not walk.

    The walk of a charge is in `estimator.let_emf_wander`.

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
