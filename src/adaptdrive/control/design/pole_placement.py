"""Pole placement for a controller with an integrator, and the loop that its gains make.

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

The design is right for the estimate itself; the load may lie anywhere within its covariance. What
matters of that is the loop. With L Lᵀ the covariance of the physical parameters p, the loads

    p ± c l_j        l_j the columns of L, c the confidence

are closed with the proposed gains. A loop that one of them makes unstable, with a margin, is not
to be had. Otherwise the square root of the sum over j of the squared differences from the response
of the estimate, at the slow sample where it is largest, is how far the response to a step may be
off. To first order it is c standard deviations of the response.

A parameter that the response hardly depends on, such as a short second lag, may be as uncertain as
it likes. Parameters that the samples leave open along a direction that the loop does not see, such
as a gain and time constants that grow together, count for what they do together.
"""

import math

from adaptdrive.control import thresholds, vectors
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import ControllerSettings, Rates
from adaptdrive.control.vectors import Vector

# Pole placement for a controller with an integrator, any order.


def desired_polynomial(pole: float, count: int) -> Vector:
    """(1 - pole q^-1)^count."""
    polynomial = [1.0]
    for _ in range(count):
        polynomial = vectors.multiply(polynomial, [1.0, -pole])
    return polynomial


# From a load model to the gains of the compensator, for both designs.

_HALVINGS = 50
"""Halvings of an interval of 1 until it is as short as the rounding of a double."""


def _delay_ticks(rates: Rates, load: Load) -> float:
    """Fast ticks from a snapshot to the mean effect of its decision on the output."""
    return rates.latency_ticks + rates.lag_ticks + load.delay_s / rates.nominal_tick_s


def reference_lead(settings: ControllerSettings, load: Load) -> float:
    """Delay from a decision to its mean effect, in slow periods; the paper leaves it out.

    What responds at once has responded by the next slow instant, whenever in between it began.
    """
    if not settings.exact or load.numerator[0] != 0.0:
        return 0.0
    return _delay_ticks(settings.rates, load) / settings.rates.ticks_per_period


def past_inputs(settings: ControllerSettings, load: Load) -> int:
    """Return the number of past inputs that the compensator needs."""
    period_s = settings.rates.ticks_per_period * settings.rates.nominal_tick_s
    numerator, denominator = list(load.numerator), list(load.denominator)
    _, b = discrete_model(settings, load, numerator, denominator, period_s)
    return len(b) - 1


def discrete_model(
    settings: ControllerSettings,
    load: Load,
    numerator: Vector,
    denominator: Vector,
    period_s: float,
) -> tuple[Vector, Vector]:
    """The model A, B in q^-1 that the chosen design works with.

    A mean over M samples ends half a tick after the last of them, when it is seen as an average
    over M whole ticks.
    """
    if not settings.exact:
        return load.paper_model(numerator, denominator, period_s)
    rates, delay_ticks, window_ticks = settings.rates, _delay_ticks(settings.rates, load), 0.0
    if rates.samples > 1:
        delay_ticks, window_ticks = delay_ticks - 0.5, float(rates.samples)
    tick_s = period_s / rates.ticks_per_period
    return held_model(numerator, denominator, period_s, delay_ticks * tick_s, window_ticks * tick_s)


def kept_factor(b: Vector, pole: float) -> Vector:
    """The factor of A_m that cancels a zero of the load, [1.0] where none is cancelled.

    A zero that is slower than the pole takes the place of one pole. A battery has one close to its
    own pole, and moving that pole away would take enormous gains.
    """
    low, high, end = pole, 1.0, vectors.total(b)
    if not _value(b, low) * end < 0.0:
        return [1.0]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _value(b, middle) * end < 0.0:
            low = middle
        else:
            high = middle
    return [1.0, -high]


def _value(b: Vector, z: float) -> float:
    """z^n B(z)."""
    value = 0.0
    for coefficient in b:
        value = value * z + coefficient
    return value


# Assurance: how far the loop that new gains make may differ from the one asked for.

STABLE_RADIUS = 1.0 - math.sqrt(thresholds.NOISE_FLOOR)
"""Largest pole of a possible load that is stable: in one of 10,000 slow periods it loses less than
the least noise."""

_SMALLEST_SHARE = 0.05
"""Least share of a parameter that is tried: physical parameters are positive."""

_LONGEST = 10 * thresholds.WINDOW
"""Samples of a response that are compared at most: twice the delay of four poles at 0.96."""


def possible_plants(
    settings: ControllerSettings,
    load: Load,
    values: Vector,
    root: Vector,
    period_s: float,
) -> list["Plant"]:
    """Return the plants of p + c l_j and p - c l_j for each j; none where L is not known.

    Args:
        settings: Design, and the confidence.
        load: The load.
        values: Estimated physical parameters p.
        root: L, flat, square.
        period_s: T_k.
    """
    count, plants = len(values), list["Plant"]()
    for column in range(count if vectors.all_finite(root) else 0):
        for sign in (settings.supervision.confidence, -settings.supervision.confidence):
            moved = [values[i] + sign * root[i * count + column] for i in range(count)]
            vertex = [max(moved[i], _SMALLEST_SHARE * values[i]) for i in range(count)]
            plants.append(Plant(*discrete_model(settings, load, *load.realise(vertex), period_s)))
    return plants


def is_stable(loop: Vector) -> bool:
    """Return whether a loop A_c is stable, with the margin of a possible load."""
    return vectors.all_finite(loop) and vectors.is_stable(loop, STABLE_RADIUS)


class Plant:
    """A discrete model of a load, A y = B u, and the loops that controllers close around it.

    Gains are r_1 ... r_n, s_0 ... s_m.

    Attributes:
        a: A, first entry 1.
        b: B, first entry (direct term) 0.
        order: m.
        free: Number of poles that nobody asks for.
    """

    def __init__(self, a: Vector, b: Vector) -> None:
        """Take a model.

        Args:
            a: A.
            b: B.
        """
        self.a = a
        self.b = b
        self.order = len(a) - 1
        self.free = len(b) - len(a)
        self._solved: Vector = []
        self._loop: Vector = []
        self._placed: tuple[Vector, Vector] = [], []

    @property
    def gain(self) -> float:
        """The dc gain."""
        return vectors.total(self.b) / vectors.total(self.a)

    def asked(self, pole: float) -> Vector:
        """A_m: 2m equal poles, one of which gives way to a zero of the load that is cancelled."""
        return self.asked_beside(kept_factor(self.b, pole), pole)

    def asked_beside(self, kept: Vector, pole: float) -> Vector:
        """Return a factor of A_m that is not moved, [1.0] for none, times 2m poles in all."""
        return vectors.multiply(kept, desired_polynomial(pole, 2 * self.order + 1 - len(kept)))

    def place(self, loop: Vector) -> tuple[Vector, Vector]:
        """Return controller polynomials R and S for a closed loop with given poles.

        Args:
            loop: A_c, first entry 1, at most as long as A and B have taps together, plus one.

        Returns:
            R (first entry 1, R(1) = 0) and S; NaNs where A and B share a root.
        """
        if loop != self._loop:  # gains, noise and margins of a loop ask for the same one
            self._loop, self._placed = list(loop), self._solve(loop)
        return self._placed

    def _solve(self, loop: Vector) -> tuple[Vector, Vector]:
        integrating, count = vectors.multiply(self.a, [1.0, -1.0]), len(self.b) - 2
        size = count + len(self.a)
        if not self._solved:  # the same for every loop
            self._solved = _equation(integrating, self.b)
        right = [*loop[1:], *[0.0] * size][:size]
        for i in range(len(self.a)):
            right[i] -= integrating[i + 1]
        solution = vectors.substitute(self._solved, self._solved[size * size :], right)
        return vectors.multiply([1.0, *solution[:count]], [1.0, -1.0]), solution[count:]

    def gains(self, loop: Vector) -> Vector:
        """Return the gains that place the poles of a loop A_c."""
        r, s = self.place(loop)
        return [*r[1:], *s]

    def closed(self, gains: Vector) -> Vector:
        """Return A R + B S: its roots are the poles of the loop that gains close."""
        taps = len(gains) - len(self.a)
        loop = vectors.multiply(self.a, [1.0, *gains[:taps]])
        back = vectors.multiply(self.b, gains[taps:])
        return [loop[i] + back[i] for i in range(len(loop))]

    def response_spread(self, possible: list["Plant"], loop: Vector, pole: float) -> float:
        """Return how far the response to a step may be off, as a share of the step.

        Args:
            possible: Those of `possible_plants`.
            loop: A_c of the loop that is designed for this plant.
            pole: Pole asked for.

        Returns:
            The share; infinite where a load within the covariance makes the loop unstable, or
            nothing is known of it.
        """
        gains = self.gains(loop)
        driven = self._driven(gains, loop, pole)
        own = self.response(gains, driven)
        squares = [0.0 if possible else math.inf] * len(own)
        for j in range(0, len(possible), 2):
            ahead = possible[j].response(gains, driven)
            behind = possible[j + 1].response(gains, driven)
            for i in range(len(own)):
                largest = max(abs(ahead[i] - own[i]), abs(behind[i] - own[i]))
                squares[i] += largest * largest
        return math.sqrt(max(squares))

    def _driven(self, gains: Vector, loop: Vector, pole: float) -> Vector:
        """t0 r" of a unit step behind the reference filter, until the response has settled."""
        asked = self.asked(pole)
        settled = round(4.0 * self.order * pole / (1.0 - pole)) + len(self.b)
        share = vectors.total(gains[len(self.b) - 1 :]) * vectors.total(asked) / vectors.total(loop)
        return _filtered([share * one for one in loop], asked, [1.0] * min(_LONGEST, settled))

    def response(self, gains: Vector, driven: Vector) -> Vector:
        """y[k] in the loop of some gains; infinite where that is not stable."""
        loop = self.closed(gains)
        return _filtered(self.b, loop, driven) if is_stable(loop) else [math.inf] * len(driven)


def _equation(integrating: Vector, b: Vector) -> Vector:
    """Return the matrix of A (1 - q^-1) R' + B S, eliminated, and the pivots behind it."""
    free, feedback = len(b) - 2, len(integrating) - 1
    size = free + feedback
    matrix = [0.0] * (size * size)
    for j in range(free):
        for i in range(len(integrating)):
            matrix[(i + j) * size + j] = integrating[i]
    for j in range(feedback):
        for i in range(1, len(b)):
            matrix[(i + j - 1) * size + free + j] = b[i]
    pivots = vectors.eliminate(matrix, size)
    return [*matrix, *pivots]


def _filtered(numerator: Vector, denominator: Vector, signal: Vector) -> Vector:
    """A signal behind a filter in q^-1 that begins at rest."""
    inputs = vectors.multiply(numerator, signal)[: len(signal)]
    past = [0.0] * (len(denominator) - 1)
    return vectors.follow(denominator, past, inputs)[len(past) :]
