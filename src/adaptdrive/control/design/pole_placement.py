"""Pole placement for a controller with an integrator: from a load model to gains.

For the plant A y = B u the controller R u = t0 r - S y has the closed loop

    A R + B S = A_m                R = (1 - q^-1) R',   t0 = S(1)

(the Diophantine equation; Astrom and Wittenmark, Computer-Controlled Systems, chapter 5). R' is
monic with one coefficient less than B has taps, S has as many coefficients as A; the closed loop
has as many poles as A and B have taps together, and those that are not asked for lie at 0. R has
the factor 1 - q^-1, so the loop has no steady error, and t0 = S(1) makes its dc gain 1.

For B with one tap and a trailing zero this is the paper's compensator (26) with the coefficients
of V_c[k-1], V_c[k-2] corrected to (1 + x4/a2) and -x4/a2; for a first-order load it is (14)-(16).

`exact`: the held model with every delay of the loop in it: the latency of the decision, the lag
of the voltage loop, the dead time of the load, and the averaging of the output. `paper`: the
paper's own discretisation of a single, undelayed sample.
"""

from __future__ import annotations

from adaptdrive.control.discretise import held_model, input_taps
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings, Rates
from adaptdrive.control.vectors import Vector, eliminate, multiply, substitute

# Pole placement for a controller with an integrator, any order.


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


# From a load model to the gains of the compensator, for both designs.

_HALVINGS = 50
"""Halvings of an interval of 1 until it is as short as the rounding of a double."""


def loop_delay_ticks(rates: Rates) -> float:
    """Fast ticks from a snapshot to the mean effect of its decision.

    A mean over M samples ends half a tick after the last of them, when it is seen as an average
    over M whole ticks.
    """
    delay = rates.latency_ticks + rates.lag_ticks
    return delay - 0.5 if rates.samples > 1 else delay


def reference_lead(settings: ControllerSettings, load: Load) -> float:
    """Delay from a decision to its mean effect, in slow periods; the paper leaves it out.

    What responds at once has responded by the next slow instant, whenever in between it began.
    """
    if not settings.exact or load.numerator[0] != 0.0:
        return 0.0
    rates = settings.rates
    delay_ticks = rates.latency_ticks + rates.lag_ticks + load.delay_s / rates.nominal_tick_s
    return delay_ticks / rates.ticks_per_period


def window_ticks(rates: Rates) -> float:
    """Length of the averaging window, 0 for a single sample."""
    return float(rates.samples) if rates.samples > 1 else 0.0


def past_inputs(settings: ControllerSettings, load: Load) -> int:
    """Return the number of past inputs that the compensator needs."""
    if not settings.exact:
        return load.paper_taps
    rates = settings.rates
    ticks = float(rates.ticks_per_period)
    delay = loop_delay_ticks(rates) + load.delay_s / rates.nominal_tick_s
    return input_taps(load.order, ticks, delay, window_ticks(rates))


def discrete_model(
    settings: ControllerSettings,
    load: Load,
    numerator: Vector,
    denominator: Vector,
    period_s: float,
) -> tuple[Vector, Vector]:
    """The model A, B in q^-1 that the chosen design works with."""
    if not settings.exact:
        return load.paper_model(numerator, denominator, period_s)
    rates = settings.rates
    tick_s = period_s / rates.ticks_per_period
    delay_s = loop_delay_ticks(rates) * tick_s + load.delay_s * tick_s / rates.nominal_tick_s
    return held_model(numerator, denominator, period_s, delay_s, window_ticks(rates) * tick_s)


def compensator_gains(a: Vector, b: Vector, order: int, pole: float) -> Vector:
    """The gains of the compensator for 2m equal poles.

    Args:
        a: A of the model.
        b: B of the model.
        order: m.
        pole: The closed-loop pole.

    Returns:
        r_1 ... r_n, s_0 ... s_m; NaNs where the model cannot be controlled.
    """
    r, s = place_poles(a, b, asked_loop(b, order, pole))
    return [*r[1:], *s]


def loop_gains(solved: Vector, a: Vector, b: Vector, desired: Vector) -> Vector:
    """Return the gains of the loop `desired`, ordered as those of `compensator_gains`.

    Args:
        solved: The `equation` of A and B.
        a: A of the model.
        b: B of the model.
        desired: A_c.
    """
    r, s = place(solved, a, b, desired)
    return [*r[1:], *s]


def asked_loop(b: Vector, order: int, pole: float) -> Vector:
    """A_m: 2m equal poles, one of which gives way to a zero of the load that is cancelled."""
    kept = kept_factor(b, pole)
    return multiply(kept, desired_polynomial(pole, 2 * order + 1 - len(kept)))


def kept_factor(b: Vector, pole: float) -> Vector:
    """The factor of A_m that cancels a zero of the load, [1.0] where none is cancelled.

    A zero that is slower than the pole takes the place of one pole. A battery has one close to its
    own pole, and moving that pole away would take enormous gains.
    """
    if _value(b, pole) * _value(b, 1.0) < 0.0:
        return [1.0, -_zero(b, pole)]
    return [1.0]


def _value(b: Vector, z: float) -> float:
    """z^n B(z)."""
    value = 0.0
    for coefficient in b:
        value = value * z + coefficient
    return value


def _zero(b: Vector, low: float) -> float:
    """The zero of B between `low` and 1, where its sign changes."""
    high, below = 1.0, _value(b, low)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _value(b, middle) * below > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
