"""Fast feedback: disturbances are corrected as soon as noise and margins allow.

The response to the reference is that of the poles asked for, whatever the poles of the feedback are
(`reference_filter`). These decide how soon a disturbance is corrected, and at what cost: noise of
the output reaches the input through the loop, and a wrong model makes a fast loop unstable sooner
than a slow one. Two laws share one history of inputs, outputs and course:

    quiet    the poles asked for, slower where noise demands it (`noise_limit`): A_q
    fast     faster ones: p from the pole asked for down to half of it, while the poles that are
             free rise from 0 as much, which costs least noise for the speed: A_f

The fast law acts. The quiet one decides how far the course gives way at a limit of the input: the
limit that the response needs counts, not the one that a correction or its noise runs into.

A_f is the fastest loop whose noise of the input stays within a share of its limit, and which keeps
the margins (I. D. Landau and G. Zito, Digital Control Systems, 2006, section 2.6): the distance of
the open loop L = B S/(A R) from -1 on the unit circle is |A_f/(A R)|, the modulus margin; with an
additional delay of d periods the loop stays stable while |B S/A_f| |1 - z^-d| < 1.
"""

from __future__ import annotations

import math

from adaptdrive.control.design import kept_factor
from adaptdrive.control.noise_limit import impulse_norm
from adaptdrive.control.pole_placement import desired_polynomial, place
from adaptdrive.control.vectors import Vector, multiply

MODULUS_MARGIN = 0.43
"""Least distance of L from -1: a gain margin of 1.75 and a phase margin of 25° at the least."""

DELAY_MARGIN = 0.5
"""Additional delay in slow periods that the fast loop stands."""

SPENT = 0.25
"""Share of the limit of σ_u that the fast law may spend."""

_FREQUENCIES = 40
"""Frequencies at which margins are looked for, from half the sampling rate down."""

_NEXT = 0.875
"""Each frequency over the one before."""

_HALVINGS = 6
"""Halvings of the way to half the pole asked for, until the fastest is found within 0.01."""


def fast_loop(
    solved: Vector,
    a: Vector,
    b: Vector,
    order: int,
    pole: float,
    quiet: Vector,
    noise: float,
    limit: float,
    circle: Vector,
) -> Vector:
    """Return A_f; A_q where no loop faster than asked keeps within the limits.

    Args:
        solved: The `equation` of A and B.
        a: A of the model.
        b: B of the model.
        order: m.
        pole: Closed-loop pole asked for.
        quiet: A_q.
        noise: σ_y of a slow sample, in the unit of the output.
        limit: Largest σ_u of the quiet law, in the unit of the input; 0 for A_q at any noise.
        circle: That of `unit_circle` for as many entries as A_c has.
    """
    kept = kept_factor(b, pole)
    free = len(a) + len(b) - 2 - 2 * order
    low, high = 0.0, 1.0 if limit > 0.0 else 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        loop = _faster_loop(kept, order, free, pole, middle)
        r, s = place(solved, a, b, loop)
        spent = noise * impulse_norm(multiply(s, a), loop)
        if spent <= SPENT * limit and has_margins(multiply(a, r), multiply(b, s), loop, circle):
            low = middle
        else:
            high = middle
    return list(quiet) if low == 0.0 else _faster_loop(kept, order, free, pole, low)


def _faster_loop(kept: Vector, order: int, free: int, pole: float, speed: float) -> Vector:
    """Return A_f for a speed of 0 (as asked) to 1 (all poles half of the pole asked for)."""
    observer = 0.5 * speed * pole
    asked = multiply(kept, desired_polynomial(pole - observer, 2 * order + 1 - len(kept)))
    return multiply(asked, desired_polynomial(observer, free))


def unit_circle(count: int) -> Vector:
    """Return what margins need at all frequencies, a row for each, the same in every slow period.

    Args:
        count: Coefficients of a polynomial in q^-1.

    Returns:
        Real and imaginary parts of its powers of q^-1, and |1 - z^-d|² at the end of the row.
    """
    row = 2 * count + 1
    circle = [0.0] * (row * _FREQUENCIES)
    angle = math.pi
    for first in range(0, len(circle), row):
        for i in range(count):
            circle[first + 2 * i] = math.cos(i * angle)
            circle[first + 2 * i + 1] = math.sin(i * angle)
        circle[first + row - 1] = (2.0 * math.sin(0.5 * DELAY_MARGIN * angle)) ** 2
        angle *= _NEXT
    return circle


def has_margins(forward: Vector, back: Vector, loop: Vector, circle: Vector) -> bool:
    """Return whether a loop keeps the margins.

    Args:
        forward: A R.
        back: B S.
        loop: A_c = A R + B S, stable.
        circle: That of `unit_circle` for the entries of these.
    """
    row = len(circle) // _FREQUENCIES
    for first in range(0, len(circle), row):
        least = MODULUS_MARGIN * MODULUS_MARGIN * _squared(forward, circle, first)
        least = max(least, circle[first + row - 1] * _squared(back, circle, first))
        if not _squared(loop, circle, first) > least:
            return False
    return True


def _squared(polynomial: Vector, circle: Vector, first: int) -> float:
    """Return the squared size of a polynomial in q^-1 at the frequency that begins at an entry."""
    real, imaginary = 0.0, 0.0
    for i in range(len(polynomial)):
        real += polynomial[i] * circle[first + 2 * i]
        imaginary += polynomial[i] * circle[first + 2 * i + 1]
    return real * real + imaginary * imaginary
