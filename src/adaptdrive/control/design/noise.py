"""Closed-loop poles within the noise: detuned ones, and fast ones where noise and margins allow.

White noise e of the slow samples, with standard deviation σ_y, reaches the input through the loop:

    A y = B u,  R u = t0 r - S (y + e)      u = -(S A / A_c) e      A_c = A R + B S
    σ_u = σ_y ‖S A / A_c‖₂

The asked poles A_m may cost more of σ_u than the input can give: the gains grow with the inertia.
Where σ_u would be above its limit, the poles that are free, at 0 otherwise, become observer poles
first, up to 0.8; where that does not suffice, the asked poles p become slower, 1 - p down to a
quarter. A zero that is cancelled stays where it is.

Slower poles are quieter down to about the load's own; gains that keep a load slower than it is rise
again. Where no slowness on the way meets the limit, the quietest that was tried takes its place.

The norm is the sum of the squared impulse response (K. J. Åström, Introduction to Stochastic
Control Theory, 1970, section 5.2): with a, b of degree n, the recursion

    α = a_k/a_0    β = b_k/a_0    a_i <- a_i - α a_(k-i)    b_i <- b_i - β a_(k-i)    k = n ... 1

adds b_k β to it in each step, and b_0²/a_0 at the end, for a_0 = 1 at the start.

The response to the reference is that of the poles asked for, whatever the poles of the feedback are
(`reference`). These decide how soon a disturbance is corrected, and at what cost: noise of
the output reaches the input through the loop, and a wrong model makes a fast loop unstable sooner
than a slow one. Two laws share one history of inputs, outputs and course:

    quiet    the poles asked for, slower where noise demands it: A_q
    fast     faster ones: p from the pole asked for down to half of it, while the poles that are
             free rise from 0 as much, which costs least noise for the speed: A_f

The fast law acts. The quiet one decides how far the course gives way at a limit of the input: the
limit that the response needs counts, not the one that a correction or its noise runs into.

A_f is the fastest loop whose noise of the input stays within a share of its limit, and which keeps
the margins (I. D. Landau and G. Zito, Digital Control Systems, 2006, section 2.6): the distance of
the open loop L = B S/(A R) from -1 on the unit circle is |A_f/(A R)|, the modulus margin; with an
additional delay of d periods the loop stays stable while |B S/A_f| |1 - z^-d| < 1.
"""

import math
from dataclasses import dataclass
from functools import cache

from adaptdrive.control.design.pole_placement import Plant, desired_polynomial, kept_factor
from adaptdrive.control.thresholds import FEWEST
from adaptdrive.control.vectors import Vector, copy_into, lacks, multiply

# Closed-loop poles that keep the noise of the output out of the input.

OBSERVER_POLE = 1.0 - 1.0 / FEWEST
"""Slowest observer pole: a disturbance is seen within the fewest samples that can show anything."""

SLOWEST_SHARE = 0.25
"""Least 1 - p over that of the pole asked for: four times its time constant."""

_HALVINGS = 6
"""Halvings of the way to the slowest poles, and to the fastest: found within 0.03 and 0.01."""


def detuned_loop(plant: Plant, pole: float, noise: float, limit: float) -> Vector:
    """Return A_c with the fastest poles that keep the noise of the input within its limit.

    Args:
        plant: The model.
        pole: Closed-loop pole asked for.
        noise: σ_y of a slow sample, in the unit of the output.
        limit: Largest σ_u, in the unit of the input; 0 for none.
    """
    kept = kept_factor(plant.b, pole)
    found = slowed_loop(plant, kept, pole, 0.0)
    least = noise_gain(plant, found)
    if noise * least <= limit or not limit > 0.0:
        return found
    fast, slow = 0.0, 2.0 / (1.0 - 0.5**_HALVINGS)  # so that the last one towards it is 2
    for _ in range(_HALVINGS):
        slowness = 0.5 * (fast + slow)
        loop = slowed_loop(plant, kept, pole, slowness)
        gain = noise_gain(plant, loop)
        within = noise * gain <= limit
        if within or gain < least:
            found, least = loop, 0.0 if within else gain
        fast, slow = (fast, slowness) if within else (slowness, slow)
    return found


def slowed_loop(plant: Plant, kept: Vector, pole: float, slowness: float) -> Vector:
    """Return A_c for a slowness of -1 (all poles half of the pole asked for) to 0 (as asked).

    From there it goes on to 1 (observer poles) and 2 (all poles slow).

    Args:
        plant: The model.
        kept: Factor of A_m that is not moved, [1.0] for none.
        pole: Closed-loop pole asked for.
        slowness: -1 to 2.
    """
    if slowness < 0.0:
        observer = -0.5 * slowness * pole
        moved = pole - observer
    else:
        observer = OBSERVER_POLE * min(slowness, 1.0)
        moved = 1.0 - (1.0 - pole) * (1.0 - (1.0 - SLOWEST_SHARE) * max(slowness - 1.0, 0.0))
    return multiply(plant.asked_beside(kept, moved), desired_polynomial(observer, plant.free))


def noise_gain(plant: Plant, loop: Vector) -> float:
    """Return ‖S A / A_c‖₂ of the controller that gives a model this loop.

    Args:
        plant: The model.
        loop: A_c, stable.
    """
    _, s = plant.place(loop)
    return impulse_norm(multiply(s, plant.a), loop)


def impulse_norm(numerator: Vector, denominator: Vector) -> float:
    """Return the root of the sum of the squared impulse response of a stable filter in q^-1.

    It is infinite where rounding hides it: that of many poles which all are close to 1.

    Args:
        numerator: b, no longer than a.
        denominator: a, its first entry 1.
    """
    degree = len(denominator) - 1
    a, b = list(denominator), [0.0] * (degree + 1)
    copy_into(b, numerator)
    power = 0.0
    for k in range(degree, 0, -1):
        if lacks(a[0], 0.0):
            return math.inf
        alpha, beta, last = a[k] / a[0], b[k] / a[0], a[: k + 1]
        power += beta * b[k]
        for i in range(k):
            a[i] -= alpha * last[k - i]
            b[i] -= beta * last[k - i]
    return math.sqrt(power + b[0] * b[0] / a[0]) if a[0] > 0.0 else math.inf


# Fast feedback: disturbances are corrected as soon as noise and margins allow.

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


def fast_loop(plant: Plant, pole: float, quiet: Vector, noise: float, limit: float) -> Vector:
    """Return A_f; A_q where no loop faster than asked keeps within the limits.

    Args:
        plant: The model.
        pole: Closed-loop pole asked for.
        quiet: A_q.
        noise: σ_y of a slow sample, in the unit of the output.
        limit: Largest σ_u of the quiet law, in the unit of the input; 0 for A_q at any noise.
    """
    kept, found = kept_factor(plant.b, pole), quiet
    if not limit > 0.0:
        return found
    fast, slow = -1.0, 0.0
    for _ in range(_HALVINGS):
        slowness = 0.5 * (fast + slow)
        loop = slowed_loop(plant, kept, pole, slowness)
        if noise * noise_gain(plant, loop) <= SPENT * limit and has_margins(plant, loop):
            found, slow = loop, slowness
        else:
            fast = slowness
    return found


def has_margins(plant: Plant, loop: Vector) -> bool:
    """Return whether the controller that gives a model this loop keeps the margins.

    Args:
        plant: The model.
        loop: A_c, stable.
    """
    r, s = plant.place(loop)
    forward, back = multiply(plant.a, r), multiply(plant.b, s)
    for row in _unit_circle(len(loop)):
        least = MODULUS_MARGIN * MODULUS_MARGIN * _squared(forward, row)
        least = max(least, row[len(row) - 1] * _squared(back, row))
        if lacks(_squared(loop, row), least):
            return False
    return True


@cache
def _unit_circle(count: int) -> list[Vector]:
    """Return what margins need at all frequencies, a row for each.

    Args:
        count: Coefficients of a polynomial in q^-1.

    Returns:
        Real and imaginary parts of its powers of q^-1, and |1 - z^-d|² at the end of the row.
    """
    circle, angle = list[Vector](), math.pi
    for _ in range(_FREQUENCIES):
        row: Vector = []
        for i in range(count):
            row += [math.cos(i * angle), math.sin(i * angle)]
        circle.append([*row, (2.0 * math.sin(0.5 * DELAY_MARGIN * angle)) ** 2])
        angle *= _NEXT
    return circle


def _squared(polynomial: Vector, row: Vector) -> float:
    """Return the squared size of a polynomial in q^-1 at the frequency of a row."""
    real, imaginary = 0.0, 0.0
    for i in range(len(polynomial)):
        real += polynomial[i] * row[2 * i]
        imaginary += polynomial[i] * row[2 * i + 1]
    return real * real + imaginary * imaginary


@dataclass(frozen=True, slots=True)
class Law:
    """The adaptive law: two sets of gains for one plant.

    Attributes:
        plant: Discrete model of the estimate.
        asked: A_m.
        quiet_gains: Gains of the quiet law.
        quiet_noise: σ_u of it, with the noise that is counted at the least.
        fast_loop: A_c of the fast law.
        fast_gains: Its gains.
        fast_noise: σ_u of it.
    """

    plant: Plant
    asked: Vector
    quiet_gains: Vector
    quiet_noise: float
    fast_loop: Vector
    fast_gains: Vector
    fast_noise: float
