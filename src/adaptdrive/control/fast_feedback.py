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
from adaptdrive.control.noise_limit import noise_gain
from adaptdrive.control.pole_placement import desired_polynomial, place_poles
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
    a: Vector, b: Vector, order: int, pole: float, quiet: Vector, noise: float, limit: float
) -> Vector:
    """Return A_f; A_q where no loop faster than asked keeps within the limits.

    Args:
        a: A of the model.
        b: B of the model.
        order: m.
        pole: Closed-loop pole asked for.
        quiet: A_q.
        noise: σ_y of a slow sample, in the unit of the output.
        limit: Largest σ_u of the quiet law, in the unit of the input; 0 for A_q at any noise.
    """
    kept = kept_factor(b, pole)
    free = len(a) + len(b) - 2 - 2 * order
    low, high = 0.0, 1.0 if limit > 0.0 else 0.0
    circle = unit_circle(len(a) + len(b) - 1)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        loop = _faster_loop(kept, order, free, pole, middle)
        if noise * noise_gain(a, b, loop) <= SPENT * limit and has_margins(a, b, loop, circle):
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
    """Return the powers of q^-1 below a degree at all frequencies: real, imaginary, and so on."""
    circle = [0.0] * (2 * count * _FREQUENCIES)
    angle = math.pi
    for k in range(_FREQUENCIES):
        for i in range(count):
            circle[2 * (k * count + i)] = math.cos(i * angle)
            circle[2 * (k * count + i) + 1] = math.sin(i * angle)
        angle *= _NEXT
    return circle


def has_margins(a: Vector, b: Vector, loop: Vector, circle: Vector) -> bool:
    """Return whether the controller that gives a model this loop keeps the margins.

    Args:
        a: A of the model.
        b: B of the model.
        loop: A_c, stable.
        circle: That of `unit_circle` for the entries of A R and B S.
    """
    r, s = place_poles(a, b, loop)
    forward, back = multiply(a, r), multiply(b, s)
    angle = math.pi
    for first in range(0, len(circle), len(circle) // _FREQUENCIES):
        shift = 2.0 * math.sin(0.5 * DELAY_MARGIN * angle)  # |1 - z^-d|
        least = MODULUS_MARGIN * _magnitude(forward, circle, first)
        least = max(least, shift * _magnitude(back, circle, first))
        if not _magnitude(loop, circle, first) > least:
            return False
        angle *= _NEXT
    return True


def _magnitude(polynomial: Vector, circle: Vector, first: int) -> float:
    """Return the magnitude of a polynomial in q^-1 at the frequency that begins at an entry."""
    real, imaginary = 0.0, 0.0
    for i in range(len(polynomial)):
        real += polynomial[i] * circle[first + 2 * i]
        imaginary += polynomial[i] * circle[first + 2 * i + 1]
    return math.hypot(real, imaginary)
