"""Recursive least squares with exponential forgetting, in factored form.

The algorithm (3),

    ε = y - rᵀθ        g = P r / (ρ + rᵀ P r)        θ <- θ + g ε        P <- (P - g rᵀ P) / ρ

with P kept as U D Uᵀ (`ud_factors`). Forgetting stops to inflate D at a ceiling, so that P stays
finite without excitation.
"""

from __future__ import annotations

from adaptdrive.control.estimation.ud_factors import absorb, given, open_up, project, widen
from adaptdrive.control.vectors import Vector, copy_into, dot

COVARIANCE_CEILING = 1.0e12
"""Largest variance that P may grow to: above it few digits of a double would be left."""


def reset(theta: Vector, upper: Vector, diagonal: Vector, covariance: float) -> None:
    """Set θ to zero and P to `covariance` times the identity.

    Args:
        theta: θ, n entries.
        upper: U, flat, n by n.
        diagonal: D, n entries.
        covariance: p0 > 0.
    """
    copy_into(theta, [0.0] * len(theta))
    open_up(upper, diagonal, covariance)


def predict(theta: Vector, regressor: Vector) -> float:
    """rᵀθ."""
    return dot(theta, regressor)


def normalised(excitation: float, innovation: float, forgetting: float) -> float:
    """Return ε² ρ/(ρ + rᵀPr): ε² without the share that the uncertainty of θ has in it."""
    return innovation * innovation * forgetting / (forgetting + excitation)


def update(
    theta: Vector,
    upper: Vector,
    diagonal: Vector,
    regressor: Vector,
    target: float,
    forgetting: float,
) -> float:
    """Take in one sample.

    Args:
        theta: θ, n entries, overwritten.
        upper: U, flat, n by n, overwritten.
        diagonal: D, n entries, overwritten.
        regressor: r, n entries.
        target: y.
        forgetting: ρ.

    Returns:
        The innovation ε, before the update.
    """
    innovation = target - predict(theta, regressor)
    gain = [0.0] * len(theta)
    share = innovation / absorb(upper, diagonal, regressor, forgetting, gain)
    for i in range(len(theta)):
        diagonal[i] = _forget(diagonal[i], forgetting)
        theta[i] += gain[i] * share
    return innovation


def update_along(
    theta: Vector,
    upper: Vector,
    diagonal: Vector,
    regressor: Vector,
    target: float,
    forgetting: float,
) -> None:
    """Take in one sample, and forget only along it (directional forgetting).

    P is widened along P r so that rᵀPr becomes rᵀPr/ρ, then updated without forgetting: what this
    sample carries no information about keeps its variance (R. Kulhavy, Automatica 23, 1987).

    Args:
        theta: θ, n entries, overwritten.
        upper: U, flat, n by n, overwritten.
        diagonal: D, n entries, overwritten.
        regressor: r, n entries.
        target: y.
        forgetting: ρ.
    """
    size = len(theta)
    direction = [0.0] * size
    gain = [0.0] * size
    taught = project(upper, diagonal, regressor, direction)
    if taught > 0.0:
        widen(upper, diagonal, direction, (1.0 / forgetting - 1.0) / taught)
    innovation = target - predict(theta, regressor)
    share = innovation / absorb(upper, diagonal, regressor, 1.0, gain)
    for i in range(size):
        theta[i] += gain[i] * share


def update_beside(
    theta: Vector,
    upper: Vector,
    diagonal: Vector,
    regressor: Vector,
    target: float,
    forgetting: float,
    gate: float,
    walks: int,
) -> None:
    """Take in one sample, and forget along it what does not walk by itself.

    The last entries of θ, w, follow a random walk that widens P elsewhere: forgetting is for the
    others, d. What the sample says of d is forgotten directionally in the density of d alone, and
    that of w for a given d stays: with C the covariance of w for a given d and c = r_wᵀ C r_w, P
    is widened along P r - C r_w so that x = rᵀPr - c becomes x/ρ. A sample with
    x ≤ gate · (1 - ρ) (1 + c), which hardly shows d, moves w alone.

    Args:
        theta: θ, n entries, overwritten.
        upper: U, flat, n by n, overwritten.
        diagonal: D, n entries, overwritten.
        regressor: r, n entries.
        target: y.
        forgetting: ρ.
        gate: Share of the steady x below which d is not learnt.
        walks: How many entries of θ walk.
    """
    own = given(upper, diagonal, regressor, walks)
    noise, innovation = 1.0 + predict(own, regressor), target - predict(theta, regressor)
    teaches = _forget_beside(upper, diagonal, regressor, own, forgetting, gate)
    gain = [0.0] * len(theta)
    share = innovation / absorb(upper, diagonal, regressor, 1.0, gain)
    for i in range(len(theta)):
        theta[i] += gain[i] * share if teaches else own[i] * innovation / noise


def _forget_beside(
    upper: Vector, diagonal: Vector, regressor: Vector, own: Vector, forgetting: float, gate: float
) -> bool:
    """Widen P before a sample by what it will teach of d: (1/ρ - 1) x, or all of it.

    Args:
        upper: U, overwritten.
        diagonal: D, overwritten.
        regressor: r.
        own: C r_w.
        forgetting: ρ.
        gate: As in `update_beside`.

    Returns:
        Whether d is to be learnt.
    """
    noise, direction = 1.0 + predict(own, regressor), [0.0] * len(own)
    project(upper, diagonal, regressor, direction)
    for i in range(len(direction)):
        direction[i] -= own[i]
    shown = predict(direction, regressor)
    teaches = shown > min(0.5, gate * (1.0 - forgetting)) * noise
    if shown > 0.0:
        variance = (1.0 / forgetting - 1.0) / shown if teaches else 1.0 / (noise - shown)
        widen(upper, diagonal, direction, variance)
    return teaches


def _forget(variance: float, forgetting: float) -> float:
    """An entry of D after forgetting, which stops at the ceiling."""
    grown = variance / forgetting
    return grown if grown <= COVARIANCE_CEILING else max(variance, COVARIANCE_CEILING)
