"""A covariance P in the factored form U D Uᵀ, and what is done to it in that form.

U is unit upper triangular, D diagonal and positive: G. J. Bierman, Factorization Methods for
Discrete Sequential Estimation, 1977, chapter V. In this form P cannot lose its symmetry or become
indefinite by rounding, however long or poorly excited the run.
"""

from __future__ import annotations

import math

from adaptdrive.control.vectors import Vector, copy_into, identity, unit

_SMALLEST = 1.0e-12
"""Least entry of D after a transformation: 0 would end learning in its direction."""


def open_up(upper: Vector, diagonal: Vector, covariance: float) -> None:
    """Forget how sure θ is, and keep θ: P <- covariance · I."""
    copy_into(diagonal, [covariance] * len(diagonal))
    copy_into(upper, identity(len(diagonal)))


def widen(upper: Vector, diagonal: Vector, direction: Vector, variance: float) -> None:
    """P <- P + variance · v vᵀ, in factored form (Agee and Turner; Bierman 1977, section III.3).

    Args:
        upper: U, overwritten.
        diagonal: D, overwritten.
        direction: v, overwritten.
        variance: How much less sure θ becomes along v.
    """
    size = len(diagonal)
    rest = variance
    for j in range(size - 1, -1, -1):
        share = direction[j]
        grown = diagonal[j] + rest * share * share
        gain = rest * share / grown
        rest *= diagonal[j] / grown
        diagonal[j] = grown
        for i in range(j):
            direction[i] -= share * upper[i * size + j]
            upper[i * size + j] += gain * direction[i]


def excitation(upper: Vector, diagonal: Vector, regressor: Vector) -> float:
    """rᵀPr: how much a sample can teach, against the ρ that stands for its noise."""
    size = len(regressor)
    result = 0.0
    for j in range(size):
        f = regressor[j]
        for i in range(j):
            f += upper[i * size + j] * regressor[i]
        result += diagonal[j] * f * f
    return result


def project(upper: Vector, diagonal: Vector, regressor: Vector, direction: Vector) -> float:
    """Write P r, and return rᵀ P r.

    Args:
        upper: U.
        diagonal: D.
        regressor: r.
        direction: P r, overwritten; zeros before.
    """
    size = len(diagonal)
    total = 0.0
    for j in range(size):
        f = regressor[j]
        for i in range(j):
            f += upper[i * size + j] * regressor[i]
        v = diagonal[j] * f
        total += f * v
        direction[j] += v
        for i in range(j):
            direction[i] += upper[i * size + j] * v
    return total


def given(upper: Vector, diagonal: Vector, regressor: Vector, walks: int) -> Vector:
    """C r: the same with the covariance that the last entries of θ have for given others.

    Args:
        upper: U.
        diagonal: D.
        regressor: r.
        walks: How many the last entries are; C is zero elsewhere.
    """
    size = len(diagonal)
    gain, known, weights = [0.0] * size, list(upper), list(diagonal)
    for i in range(size - walks):
        absorb(known, weights, unit(size, i), _SMALLEST, gain)
    result = [0.0] * size
    project(known, weights, regressor, result)
    for i in range(size - walks):
        result[i] = 0.0
    return result


def absorb(upper: Vector, diagonal: Vector, regressor: Vector, noise: float, gain: Vector) -> float:
    """P <- P - P r rᵀ P / (noise + rᵀ P r), in factored form (Bierman's update).

    Args:
        upper: U, overwritten.
        diagonal: D, overwritten.
        regressor: r.
        noise: Variance that stands for the sample's noise.
        gain: P r of the old P, overwritten.

    Returns:
        noise + rᵀ P r of the old P.
    """
    size = len(regressor)
    scale = noise
    for j in range(size):
        f = regressor[j]
        for i in range(j):
            f += upper[i * size + j] * regressor[i]
        variance = diagonal[j]
        v = variance * f
        grown = scale + f * v
        diagonal[j] = variance * (scale / grown)
        gain[j] = v
        step = -f / scale
        for i in range(j):
            place = i * size + j
            old = upper[place]
            upper[place] = old + gain[i] * step
            gain[i] += old * v
        scale = grown
    return scale


def bound(upper: Vector, diagonal: Vector, information: float) -> None:
    """P⁻¹ <- P⁻¹ + information · I: keeps P bounded where nothing excites it.

    With information = (1 - ρ)/p after every update by forgetting ρ this is exponential resetting:
    P stays below p · I for ever (Salgado, Goodwin and Middleton, Int. J. Control 47, 1988).
    """
    if not information > 0.0:
        return
    size = len(diagonal)
    gain = [0.0] * size
    for i in range(size):
        absorb(upper, diagonal, unit(size, i), 1.0 / information, gain)


def transform(upper: Vector, diagonal: Vector, matrix: Vector) -> None:
    """P <- M P Mᵀ, in factored form.

    Args:
        upper: U, overwritten.
        diagonal: D, overwritten.
        matrix: M, flat, n by n.
    """
    size = len(diagonal)
    columns = [0.0] * (size * size)
    for i in range(size):
        for j in range(size):
            for m in range(j + 1):
                columns[i * size + j] += matrix[i * size + m] * upper[m * size + j]
    weights = list(diagonal)
    factor(columns, weights, upper, diagonal)


def factor(columns: Vector, weights: Vector, upper: Vector, diagonal: Vector) -> None:
    """Bring W diag(w) Wᵀ into the form U D Uᵀ (Thornton's weighted Gram-Schmidt).

    Bierman 1977, section VI.4. A row without any weight gets the smallest variance that is left.

    Args:
        columns: W, flat, n by n, overwritten.
        weights: w, n entries, none negative.
        upper: U, overwritten.
        diagonal: D, overwritten.
    """
    size = len(diagonal)
    for j in range(size - 1, -1, -1):
        total = 0.0
        for m in range(size):
            total += weights[m] * columns[j * size + m] * columns[j * size + m]
        diagonal[j] = max(total, _SMALLEST)
        upper[j * size + j] = 1.0
        for i in range(j):
            shared = 0.0
            for m in range(size):
                shared += weights[m] * columns[i * size + m] * columns[j * size + m]
            ratio = shared / diagonal[j]
            upper[i * size + j], upper[j * size + i] = ratio, 0.0
            for m in range(size):
                columns[i * size + m] -= ratio * columns[j * size + m]


def covariance(upper: Vector, diagonal: Vector) -> Vector:
    """P = U D Uᵀ, flat, n by n."""
    size = len(diagonal)
    result = [0.0] * (size * size)
    for i in range(size):
        for j in range(size):
            for m in range(max(i, j), size):
                result[i * size + j] += upper[i * size + m] * diagonal[m] * upper[j * size + m]
    return result


def standard_deviation(jacobian: Vector, upper: Vector, diagonal: Vector, noise: float) -> float:
    """Standard deviation of a quantity that depends on θ: sqrt(σ² Jᵀ P J).

    Args:
        jacobian: Derivatives of the quantity by each parameter.
        upper: U.
        diagonal: D.
        noise: σ, standard deviation of the innovation of a settled estimate.
    """
    return noise * math.sqrt(max(0.0, excitation(upper, diagonal, jacobian)))
