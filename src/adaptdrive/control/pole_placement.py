"""Pole placement for a controller with an integrator, any order.

For the plant A y = B u the controller R u = t0 r - S y has the closed loop

    A R + B S = A_m                R = (1 - q^-1) R',   t0 = S(1)

(the Diophantine equation; Astrom and Wittenmark, Computer-Controlled Systems, chapter 5). R' is
monic with one coefficient less than B has taps, S has as many coefficients as A; the closed loop
has as many poles as A and B have taps together, and those that are not asked for lie at 0. R has
the factor 1 - q^-1, so the loop has no steady error, and t0 = S(1) makes its dc gain 1.

For B with one tap and a trailing zero this is the paper's compensator (26) with the coefficients
of V_c[k-1], V_c[k-2] corrected to (1 + x4/a2) and -x4/a2; for a first-order load it is (14)-(16).
"""

from __future__ import annotations

from adaptdrive.control.vectors import Vector, eliminate, multiply, substitute


def desired_polynomial(pole: float, count: int) -> Vector:
    """(1 - pole q^-1)^count."""
    polynomial = [0.0] * (count + 1)
    polynomial[0] = 1.0
    for degree in range(1, count + 1):
        for i in range(degree, 0, -1):
            polynomial[i] -= pole * polynomial[i - 1]
    return polynomial


def place_poles(a: Vector, b: Vector, desired: Vector) -> tuple[Vector, Vector]:
    """Controller polynomials R and S for a closed loop with given poles.

    Args:
        a: A, first entry 1.
        b: B, first entry (direct term) 0.
        desired: A_m, first entry 1, at most as long as A and B have taps together, plus one.

    Returns:
        R (first entry 1, R(1) = 0) and S; NaNs where A and B share a root.
    """
    return place(equation(a, b), a, b, desired)


def equation(a: Vector, b: Vector) -> Vector:
    """Return the equation of A and B, which is the same for every loop, eliminated.

    Returns:
        Its matrix, and the pivots behind it.
    """
    integrating = multiply(a, [1.0, -1.0])
    free, feedback = len(b) - 2, len(a)
    size = free + feedback
    matrix = [0.0] * (size * size)
    for row in range(size):
        power = row + 1
        for j in range(free):
            matrix[row * size + j] = _entry(integrating, power - 1 - j)
        for j in range(feedback):
            matrix[row * size + free + j] = _entry(b, power - j)
    pivots = eliminate(matrix, size)
    return [*matrix, *pivots]


def place(solved: Vector, a: Vector, b: Vector, desired: Vector) -> tuple[Vector, Vector]:
    """Return what `place_poles` does, from the `equation` of A and B."""
    integrating = multiply(a, [1.0, -1.0])
    free = len(b) - 2
    size = free + len(a)
    right = [_entry(desired, i + 1) - _entry(integrating, i + 1) for i in range(size)]
    solution = substitute(solved, solved[size * size :], right)
    return multiply([1.0, *solution[:free]], [1.0, -1.0]), solution[free:]


def closed_loop_polynomial(a: Vector, b: Vector, r: Vector, s: Vector) -> Vector:
    """A R + B S: its roots are the poles of the loop that R, S close around any A, B."""
    forward, back = multiply(a, r), multiply(b, s)
    return [_entry(forward, i) + _entry(back, i) for i in range(max(len(forward), len(back)))]


def _entry(polynomial: Vector, power: int) -> float:
    return polynomial[power] if 0 <= power < len(polynomial) else 0.0
