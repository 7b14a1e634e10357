"""From a continuous-time load model to the discrete one that the design needs.

All models here are written in the backward shift q^-1:

    y[k] + a_1 y[k-1] + ... + a_m y[k-m] = b_0 u[k] + b_1 u[k-1] + ... + b_n u[k-n]

`held_model` is exact for an input that is held between slow instants, takes effect after a delay,
and an output that is the mean over a window before the slow instant. It works from the response
to a unit step, s(t), and its integral S(t): the sampled output after a step is

    s_j = (S(j T - d) - S(j T - d - w)) / w         (s(j T - d) for a window w = 0)

and B follows from A times the differences of s_j. A is the characteristic polynomial of the
transition matrix over one period (Astrom and Wittenmark, Computer-Controlled Systems, chapter 2).

An impulse of area T·V_c at each slow instant is out of reach: within one half line cycle it would
be 120 V_c. The sampled output depends on less: a load with time constants far above T takes from
the course of its input only the area and the first moments. So V_c is held, and each change of it,
ΔV, is exaggerated for a while: by c_1 ΔV, then by c_2 ΔV, each for a share of the period. With S_d
the response to a step that acts d after the slow instant, the numerator of the sampled load is

    B = B_d + c_1 (B_d - B_(d+w)) + c_2 (B_(d+w) - B_(d+2w))

and c_1, c_2 are chosen so that only its first coefficient is left, as in (24).
"""

import math

from adaptdrive.control.loads.load import Load
from adaptdrive.control.vectors import Vector, copy_into, identity, reaches

# From a continuous-time load model to the discrete one that the design needs.

_TAYLOR_TERMS = 30
"""Terms of the exponential: 2^30/30! is below the rounding of a double."""

_LONGEST_STEP = 2.0
"""Norm of one Taylor step; a longer one loses digits by cancellation."""

_LONGEST_REACH = 1.0e4
"""Norm from which the model is given up as NaN: it would take 5,000 Taylor steps."""

_LARGEST_EXPONENT = 700.0
"""Largest argument of exp before a double overflows (709)."""


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
        A (m + 1 entries, first one 1) and B (`input_taps` entries, plus the leading b_0).
    """
    order = len(denominator) - 1
    count = order + input_taps(0, period_s, delay_s, window_s) + 1
    system = _companion(numerator, denominator)
    transition = _transition(system, order + 2, period_s)
    wanted = [0.0] * (order + 2)
    if window_s > 0.0:
        wanted[order + 1] = 1.0
        late = _responses(system, transition, wanted, -delay_s, period_s, count)
        before_s = delay_s + window_s
        early = _responses(system, transition, wanted, -before_s, period_s, count)
        steps = [(late[j] - early[j]) / window_s for j in range(count)]
    else:
        copy_into(wanted, system[order:])
        steps = _responses(system, transition, wanted, -delay_s, period_s, count)
    a = _characteristic(transition, order)
    return a, _numerator_from_steps(a, steps)


def input_taps(order: int, period_s: float, delay_s: float, window_s: float) -> int:
    """Return the number of past inputs in the model of `held_model`: n in the equation above."""
    return order + math.ceil((delay_s + window_s) / period_s - 1e-9)


def _companion(numerator: Vector, denominator: Vector) -> Vector:
    """Return the non-trivial entries of M in z' = M z, z = (x, u, ∫y), in companion form.

    x_1' = x_2, ..., x_m' = u - a_m x_1 - ... - a_1 x_m and u' = 0;
    y = c_m x_1 + ... + c_1 x_m + b_0 u.

    Returns:
        -a_m ... -a_1, c_m ... c_1, b_0.
    """
    order = len(denominator) - 1
    system = [0.0] * (2 * order + 1)
    for i in range(order):
        system[i] = -denominator[order - i]
        system[order + i] = numerator[order - i] - denominator[order - i] * numerator[0]
    system[2 * order] = numerator[0]
    return system


def propagate(system: Vector, states: Vector, duration_s: float) -> None:
    """z <- exp(M t) z by a Taylor series over steps short enough for full precision.

    A system too fast for the duration by four orders of magnitude gives NaNs: as a load model it
    is absurd, and working it out could keep a control loop waiting.

    Args:
        system: -a_m ... -a_1, c_m ... c_1, b_0.
        states: z: x_1 ... x_m, u, ∫y, or several z, one behind the other; overwritten.
        duration_s: t.
    """
    reach = _norm(system, len(system) // 2) * duration_s
    terms = [math.nan] * len(states)
    if reaches(reach, _LONGEST_REACH):
        copy_into(states, terms)
        return
    steps = max(1, math.ceil(reach / _LONGEST_STEP))
    for _ in range(steps):
        copy_into(terms, states)
        _taylor_step(system, states, terms, duration_s / steps)


def _taylor_step(system: Vector, states: Vector, terms: Vector, step_s: float) -> None:
    """Add t^n/n! M^n z for n = 1, 2, ... to z until it makes no difference; terms begin as z."""
    size = len(system) // 2 + 2
    for n in range(1, _TAYLOR_TERMS + 1):
        for first in range(0, len(terms), size):
            _next_term(system, terms, first, step_s / n)
        if not _add(states, terms):
            break


def _next_term(system: Vector, terms: Vector, first: int, share: float) -> None:
    """Make t^n/n! M^n z, which begins at an entry, of the term before."""
    order = len(system) // 2
    u = terms[first + order]
    rise, slope = u, system[2 * order] * u
    for i in range(order):
        x = terms[first + i]
        rise += system[i] * x
        slope += system[order + i] * x
    for i in range(order - 1):
        terms[first + i] = share * terms[first + i + 1]
    if order > 0:
        terms[first + order - 1] = share * rise
    terms[first + order], terms[first + order + 1] = 0.0, share * slope


def _add(states: Vector, terms: Vector) -> bool:
    """Add terms of a series; return whether a sum has changed."""
    counts = False
    for i in range(len(states)):
        grown = states[i] + terms[i]
        if grown != states[i]:
            states[i] = grown
            counts = True
    return counts


def _norm(system: Vector, order: int) -> float:
    """The largest sum of sizes in a row of M."""
    feedback, output = 1.0, abs(system[2 * order])
    for i in range(order):
        feedback += abs(system[i])
        output += abs(system[order + i])
    return max(feedback, output)


def _transition(system: Vector, size: int, duration_s: float) -> Vector:
    """exp(M t), flat."""
    columns, transition = identity(size), [0.0] * (size * size)
    propagate(system, columns, duration_s)
    for j in range(size):
        for i in range(size):
            transition[i * size + j] = columns[j * size + i]
    return transition


def _transit(transition: Vector, state: Vector) -> Vector:
    """exp(M t) z."""
    size = len(state)
    moved = [0.0] * size
    for i in range(size):
        for j in range(size):
            moved[i] += transition[i * size + j] * state[j]
    return moved


def _responses(
    system: Vector,
    transition: Vector,
    wanted: Vector,
    start_s: float,
    period_s: float,
    count: int,
) -> Vector:
    """A weighted sum of z after a unit step of u, at start, start + T, ...; 0 before the step."""
    size = len(wanted)
    responses = [0.0] * count
    state = [0.0] * size
    begun = False
    for j in range(count):
        time_s = start_s + j * period_s
        if begun:
            state = _transit(transition, state)
        elif time_s >= 0.0:
            state[size - 2] = 1.0
            propagate(system, state, time_s)
            begun = True
        if begun:
            for i in range(size):
                responses[j] += wanted[i] * state[i]
    return responses


def _characteristic(transition: Vector, order: int) -> Vector:
    """Characteristic polynomial of the load's part of the transition matrix."""
    size = order + 2
    block = [0.0] * (order * order)
    for i in range(order):
        for j in range(order):
            block[i * order + j] = transition[i * size + j]
    return _faddeev(block, order)


def _faddeev(matrix: Vector, order: int) -> Vector:
    """Characteristic polynomial of a matrix (Faddeev and LeVerrier)."""
    polynomial = [0.0] * (order + 1)
    polynomial[0] = 1.0
    auxiliary = [0.0] * (order * order)
    for degree in range(1, order + 1):
        following = [0.0] * (order * order)
        for i in range(order):
            for j in range(order):
                shifted = 0.0
                for m in range(order):
                    entry = auxiliary[m * order + j]
                    if m == j:
                        entry += polynomial[degree - 1]
                    shifted += matrix[i * order + m] * entry
                following[i * order + j] = shifted
        trace = 0.0
        for i in range(order):
            trace += following[i * order + i]
        polynomial[degree] = -trace / degree
        auxiliary = following
    return polynomial


def _numerator_from_steps(a: Vector, steps: Vector) -> Vector:
    count = len(steps)
    b = [0.0] * count
    for j in range(count):
        for i in range(min(j, len(a) - 1) + 1):
            before = steps[j - i - 1] if j - i > 0 else 0.0
            b[j] += a[i] * (steps[j - i] - before)
    return b


def impulse_invariant_pair(
    gain: float, tau_sum_s: float, tau_product_s2: float, period_s: float
) -> tuple[Vector, Vector]:
    """Impulse-invariant model of g/((τ1 s + 1)(τ2 s + 1)), eq. (24) with (25) corrected.

        a_1 = -(e^(-T/τ1) + e^(-T/τ2))    a_2 = e^(-T/τ1 - T/τ2)
        b_1 = T g (e^(-T/τ1) - e^(-T/τ2)) / (τ1 - τ2)

    written in the sum and the product of the time constants, so that equal ones and complex
    pairs need no special case.

    Args:
        gain: g.
        tau_sum_s: τ1 + τ2.
        tau_product_s2: τ1 τ2.
        period_s: T, the slow period.

    Returns:
        A and B; B has a trailing zero, so that the design has as many poles as the paper's.
    """
    decay = 0.5 * tau_sum_s / tau_product_s2
    split = decay * decay - 1.0 / tau_product_s2
    if -decay * period_s > _LARGEST_EXPONENT:
        return [math.nan] * 3, [math.nan] * 3
    shrink = math.exp(-decay * period_s)
    a = [1.0, -2.0 * shrink * _cosh_root(split, period_s), shrink * shrink]
    b1 = period_s * gain / tau_product_s2 * shrink * _sinh_root(split, period_s)
    return a, [0.0, b1, 0.0]


def exponential(exponent: float) -> float:
    """e^x, infinite where it is too large for a double, as an absurd estimate may have it."""
    return math.exp(exponent) if exponent < _LARGEST_EXPONENT else math.inf


def _cosh_root(square: float, time_s: float) -> float:
    """cosh(sqrt(q) t), real for either sign of q."""
    angle = math.sqrt(abs(square)) * time_s
    if square < 0.0:
        return math.cos(angle)
    return math.cosh(angle) if angle < _LARGEST_EXPONENT else math.inf


def _sinh_root(square: float, time_s: float) -> float:
    """sinh(sqrt(q) t)/sqrt(q), real for either sign of q and smooth at q = 0."""
    angle = math.sqrt(abs(square)) * time_s
    if angle < 1e-4:
        return time_s * (1.0 + square * time_s * time_s / 6.0)
    if square > 0.0:
        return math.sinh(angle) / angle * time_s if angle < _LARGEST_EXPONENT else math.inf
    return math.sin(angle) / angle * time_s


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
    starts_s = (delay_s, delay_s + width_s, delay_s + 2.0 * width_s)
    held, later, latest = (_numerator(load, period_s, one) for one in starts_s)
    first = [held[i] - later[i] for i in range(len(held))]
    second = [later[i] - latest[i] for i in range(len(held))]
    determinant = first[2] * second[3] - first[3] * second[2]
    c1 = (held[3] * second[2] - held[2] * second[3]) / determinant
    c2 = (held[2] * first[3] - held[3] * first[2]) / determinant
    return c1, c2


def _numerator(load: Load, period_s: float, delay_s: float) -> Vector:
    return held_model(list(load.numerator), list(load.denominator), period_s, delay_s, 0.0)[1]
