"""From a continuous-time load model to the discrete one that the design needs.

All models here are written in the backward shift q^-1:

    y[k] + a_1 y[k-1] + ... + a_m y[k-m] = b_0 u[k] + b_1 u[k-1] + ... + b_n u[k-n]

`held_model` is exact for an input that is held between slow instants, takes effect after a delay,
and an output that is the mean over a window before the slow instant. It works from the response
to a unit step, s(t), and its integral S(t): the sampled output after a step is

    s_j = (S(j T - d) - S(j T - d - w)) / w         (s(j T - d) for a window w = 0)

and B follows from A times the differences of s_j. A is the characteristic polynomial of the
transition matrix over one period (Astrom and Wittenmark, Computer-Controlled Systems, chapter 2).
Everything is worked out in slow periods, where s is multiplied by T: however slow a load is, its
matrix is about 1 in size.

An impulse of area T·V_c at each slow instant is out of reach: within one half line cycle it would
be 120 V_c. The sampled output depends on less: a load with time constants far above T takes from
the course of its input only the area and the first moments. So V_c is held, and each change of it,
ΔV, is exaggerated for a while: by c_1 ΔV, then by c_2 ΔV, each for a share of the period. With S_d
the response to a step that acts d after the slow instant, the numerator of the sampled load is

    B = B_d + c_1 (B_d - B_(d+w)) + c_2 (B_(d+w) - B_(d+2w))

and c_1, c_2 are chosen so that only its first coefficient is left, as in (24).
"""

import math

from adaptdrive.control import vectors
from adaptdrive.control.loads.load import Load
from adaptdrive.control.vectors import Vector

# From a continuous-time load model to the discrete one that the design needs.

_TAYLOR_TERMS = 30
"""Terms of the exponential: 2^30/30! is below the rounding of a double."""

_LONGEST_STEP = 2.0
"""Reach of one Taylor step; a longer one loses digits by cancellation."""

_LONGEST_REACH = 1.0e4
"""Reach from which the model is given up as NaN: it would take 5,000 Taylor steps."""

_ROUNDING = 1.0e-9
"""Share of a period by which a delay may miss a slow instant that it is meant for."""


def held_model(
    numerator: Vector, denominator: Vector, period_s: float, delay_s: float, window_s: float
) -> tuple[Vector, Vector]:
    """Exact discrete model of a load with held, delayed input and averaged output.

    Args:
        numerator: b_0 ... b_m, highest power of s first.
        denominator: 1, a_1 ... a_m.
        period_s: Slow period T.
        delay_s: Delay d from the slow instant to the effect of the input.
        window_s: Length w of the averaging window, 0 for a single sample.

    Returns:
        A (m + 1 entries, first one 1) and B (m + 1 entries, and one more for each period, begun
        ones included, of delay and window).
    """
    system = _system(numerator, denominator, period_s)
    size = len(denominator) + 1
    rows = vectors.identity(size)
    transition = propagated(system, rows[:-size], 1.0) + rows[-size:]  # ∫y alone stays
    late, window = delay_s / period_s, window_s / period_s
    count = len(denominator) + math.ceil(late + window - _ROUNDING)
    if window > 0.0:
        integral = vectors.unit(size, size - 1)
        after = _responses(system, transition, integral, late, count)
        before = _responses(system, transition, integral, late + window, count)
        steps = [(after[j] - before[j]) / window for j in range(count)]
    else:
        steps = _responses(system, transition, [*system[size - 2 :], 0.0], late, count)
    a = _characteristic(transition, size)
    return a, vectors.multiply(a, vectors.multiply([1.0, -1.0], steps)[:count])[:count]


def _system(numerator: Vector, denominator: Vector, period_s: float) -> Vector:
    """Return the non-trivial entries of M in z' = M z, z = (x, u, ∫y), with time in periods.

    The companion form: x_1' = x_2, ..., x_m' = u - a_m x_1 - ... - a_1 x_m and u' = 0;
    y = c_m x_1 + ... + c_1 x_m + b_0 u.

    Returns:
        -a_m ... -a_1, c_m ... c_1, b_0.
    """
    order = len(denominator) - 1
    system = [0.0] * (2 * order) + numerator[:1]
    scale = 1.0
    for i in range(order - 1, -1, -1):
        scale *= period_s
        coefficient = denominator[order - i]
        system[i] = -coefficient * scale
        system[order + i] = (numerator[order - i] - coefficient * numerator[0]) * scale
    return system


def propagated(system: Vector, states: Vector, periods: float) -> Vector:
    """Return exp(M t) z by a Taylor series over steps short enough for full precision.

    Their reach is a bound of the poles, the sum of |a_i|^(1/i) (J. L. Walsh, 1924), and 1 for u.
    A system too fast for the duration by four orders of magnitude gives NaNs: as a load model it
    is absurd, and working it out could keep a control loop waiting.

    Args:
        system: -a_m ... -a_1, c_m ... c_1, b_0.
        states: z: x_1 ... x_m, u, ∫y, or several z, one behind the other.
        periods: t.
    """
    order = len(system) // 2
    bounds = [abs(system[i]) ** (1.0 / (order - i)) for i in range(order)]
    reach = periods * (1.0 + vectors.total(bounds))
    if vectors.reaches(reach, _LONGEST_REACH):
        return [math.nan] * len(states)
    steps = max(1, math.ceil(reach / _LONGEST_STEP))
    states = list(states)
    for _ in range(steps):
        terms = list(states)
        for n in range(1, _TAYLOR_TERMS + 1):
            _derive(system, terms, periods / steps / n)
            if not _add(states, terms):
                break
    return states


def _add(states: Vector, terms: Vector) -> bool:
    """Add terms of a series; return whether a sum has changed."""
    counts = False
    for i in range(len(states)):
        grown = states[i] + terms[i]
        if grown != states[i]:
            states[i] = grown
            counts = True
    return counts


def _derive(system: Vector, states: Vector, share: float) -> None:
    """Overwrite z, or several, with a share of M z."""
    order = len(system) // 2
    for first in range(0, len(states), order + 2):
        u = first + order
        rise, slope = states[u], system[2 * order] * states[u]
        for i in range(order):
            x = states[first + i]
            rise += system[i] * x
            slope += system[order + i] * x
        for i in range(first, u - 1):
            states[i] = share * states[i + 1]
        states[u - 1], states[u], states[u + 1] = share * rise, 0.0, share * slope


def _responses(
    system: Vector, transition: Vector, output: Vector, late: float, count: int
) -> Vector:
    """Return a weighted sum of z at slow instants, after a unit step of u that acts so late."""
    size, first = len(output), max(0, math.ceil(late - _ROUNDING))
    state = propagated(system, vectors.unit(size, size - 2), max(0.0, first - late))
    responses = [0.0] * count
    for j in range(first, count):
        responses[j] = vectors.dot(output, state)
        state = _product(state, transition, size)
    return responses


def _product(rows: Vector, matrix: Vector, size: int) -> Vector:
    """Return each of some rows, one behind the other, times a square matrix."""
    result = [0.0] * len(rows)
    for first in range(0, len(rows), size):
        for j in range(size):
            value = 0.0
            for i in range(size):
                value += rows[first + i] * matrix[i * size + j]
            result[first + j] = value
    return result


def _characteristic(transition: Vector, size: int) -> Vector:
    """Characteristic polynomial of the load's part of the transition (Faddeev and LeVerrier)."""
    order = size - 2
    block = [transition[i * size + j] for i in range(order) for j in range(order)]
    polynomial, auxiliary = [1.0], [0.0] * len(block)
    for degree in range(1, order + 1):
        for i in range(0, len(block), order + 1):
            auxiliary[i] += polynomial[degree - 1]
        auxiliary = _product(auxiliary, block, order)
        polynomial.append(-vectors.total(auxiliary[:: order + 1]) / degree)
    return polynomial


# A course of v_bst after which the impulse-invariant model (24) holds.

KICK_SHARE = 0.25
"""Length of each of the two parts over the period: the shorter, the larger are the voltages."""


def kick_factors(
    load: Load, period_s: float, delay_s: float, width_s: float
) -> tuple[float, float]:
    """Return c_1 and c_2.

    Args:
        load: Of second order.
        period_s: T.
        delay_s: From the slow sample to the effect of V_c, above 0.
        width_s: w.
    """
    numerator, denominator = list(load.numerator), list(load.denominator)
    held, later, latest = (
        held_model(numerator, denominator, period_s, delay_s + i * width_s, 0.0)[1]
        for i in range(3)
    )
    moved = [one[i] - other[i] for i in (2, 3) for one, other in ((held, later), (later, latest))]
    c1, c2 = vectors.solve_linear(moved, [-held[2], -held[3]])
    return c1, c2
