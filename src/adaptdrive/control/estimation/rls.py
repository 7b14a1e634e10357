"""Recursive least squares with exponential forgetting, and its covariance P as U D Uᵀ.

U is unit upper triangular, D diagonal and positive: G. J. Bierman, Factorization Methods for
Discrete Sequential Estimation, 1977, chapter V. In this form P cannot lose its symmetry or become
indefinite by rounding, however long or poorly excited the run.

The algorithm (3),

    ε = y - rᵀθ        g = P r / (ρ + rᵀ P r)        θ <- θ + g ε        P <- (P - g rᵀ P) / ρ

with P kept as U D Uᵀ. Forgetting stops to inflate D at a ceiling, so that P stays
finite without excitation.
"""

from adaptdrive.control.vectors import Vector, copy_into, dot, identity, unit

# A covariance P in the factored form U D Uᵀ, and what is done to it in that form.

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


# Recursive least squares with exponential forgetting, in factored form.

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
    x ≤ min(1/2, gate · (1 - ρ)) (1 + c), which hardly shows d, moves w alone.

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
