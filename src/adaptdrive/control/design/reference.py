"""The reference trajectory: the response that is asked for, and its preview at a limit.

m[k]  = A_m(1)/A_m r'[k]              course of the ideal loop, without the zeros of B
    r"[k] = A_c/A_c(1) m[k]               u = (t0 r" - S y) / R,  t0 = S(1)

With t0 = A_c(1)/B(1) the output is B/B(1) m: that of the loop with the poles A_m, whatever A_c is.
With A_c = A_m the filter is 1.

Where the input is limited to u_lim, r" + (u_lim - u)/t0 would have asked for it, and the course is
set to the one that belongs to it (R. Hanus, M. Kinnaert and J.-L. Henrotte, Automatica 23, 1987,
doi:10.1016/0005-1098(87)90029-X). It continues from what the load can do, and nothing winds up. A
drive that did not follow, such as one whose V_c falls only as the load discharges it, is a limit as
well: one that is known a slow period later.

min ½ xᵀ H x - hᵀ x,  low <= x <= high

by principal pivots (K. G. Murty, Opsearch 11, 1974): the minimum over the numbers that are not held
at a limit is found exactly. The last number that it puts beyond a limit is then held there, or one
that pulls from the limit at which it is held is let go. No choice comes twice, so that this ends
with the minimum; the steps are bounded.

The response asked for is B/B(1) m*, m* = A_m(1)/A_m r'. It needs the input

    u* = A/B(1) m* + f        f: what the feedback adds, for a load torque or an error of the model

The set-points of a waveform are known, and so are m* and u* of the slow periods to come. At a limit
a law can only give way; who knows what comes moves before. The law is followed ahead from the
present course. While its input keeps the limits, it acts. Else δ is added to its limited input u,
with the least

    Σ (m[k+i] - m*[k+i])² + w (B(1)/A(1))² Σ δ²        A m = B(1) (u + δ - f)

that keeps the limits. δ changes at a few instants that double their distance. Its first value gives
m[k], and the next period plans anew.

Only the course is planned, and no sample of the output is in it but by the mean f: the law holds
the output on this course as on any other, and the noise of its input stays within the same limit.
"""

import math

from adaptdrive.control import vectors
from adaptdrive.control.design.pole_placement import Plant
from adaptdrive.control.vectors import Vector

# Reference filter: the response that is asked for, from a loop that may have other poles.


class ReferenceFilter:
    """Reference filter of the adaptive law, and what its preview has planned.

    Attributes:
        asked: A_m; zeros before there is a design.
        loop: A_c.
        course: m[k] ... m[k-n].
        ideal: m*[k] ... m*[k-n].
        offset: f; NaN while nothing is planned.
        moved: m[k] - m*[k].
    """

    def __init__(self, order: int, taps: int) -> None:
        """Begin without a design; the course begins at the first reference.

        Args:
            order: m.
            taps: n, past inputs of the law.
        """
        count = order + taps + 1
        self.asked = [0.0] * (2 * order + 1)
        self.loop = [0.0] * count
        self.course = [math.nan] * count
        self.ideal = [math.nan] * count
        self.offset = math.nan
        self.moved = 0.0


def filter_reference(state: ReferenceFilter, reference: float, planned: float = math.nan) -> float:
    """Return r"[k].

    Args:
        state: Overwritten.
        reference: r'[k].
        planned: m[k] where it is planned (`plan`), else NaN.
    """
    if vectors.total(state.loop) == 0.0 or not vectors.all_finite(state.course):
        vectors.copy_into(state.course, [reference] * len(state.course))
        return reference
    asked = [vectors.total(state.asked) * reference]
    course = vectors.follow(state.asked, state.course, asked)[-1]
    vectors.shift_in(state.course, planned if math.isfinite(planned) else course)
    return reference_of(state.loop, state.course)


def reference_of(loop: Vector, course: Vector) -> float:
    """Return r"[k] for a loop A_c."""
    return vectors.dot(loop, course) / vectors.total(loop)


def condition_reference(state: ReferenceFilter, shortage: float, gain: float) -> None:
    """Set the course to the one that asks for no more than the input gives.

    Args:
        state: Overwritten.
        shortage: Limited input minus the one that was asked for.
        gain: t0 of the law.
    """
    if gain != 0.0:
        state.course[0] += shortage / gain * vectors.total(state.loop)


# A quadratic function of a few numbers, each between its limits.

_STEPS = 20
"""Steps for each number; about one is needed."""


def minimise(matrix: Vector, right: Vector, low: Vector, high: Vector) -> Vector:
    """Return the x of the least function.

    Args:
        matrix: H, symmetric and positive definite, flat.
        right: h.
        low: Lowest x.
        high: Highest x.
    """
    count = len(right)
    x, held = [0.0] * count, [0.0] * count
    for _ in range(_STEPS * count):
        x = _least(matrix, right, low, high, held)
        if not _correct_last(matrix, right, low, high, x, held):
            break
    return [min(max(x[i], low[i]), high[i]) for i in range(count)]


def _least(matrix: Vector, right: Vector, low: Vector, high: Vector, held: Vector) -> Vector:
    """Return the x of the least function, with some numbers at a limit: the low one, -1, or 1."""
    count, part, target = len(right), list(matrix), list(right)
    for i in range(count):
        if held[i] != 0.0:
            target[i] = low[i] if held[i] < 0.0 else high[i]
            for j in range(count):
                part[i * count + j] = 1.0 if j == i else 0.0
    return vectors.solve_linear(part, target)


def _correct_last(
    matrix: Vector, right: Vector, low: Vector, high: Vector, x: Vector, held: Vector
) -> bool:
    """Hold or let go of the last number that is beyond a limit or pulls from it; False for none."""
    count = len(x)
    for i in range(count - 1, -1, -1):
        pull = right[i] - vectors.dot(matrix[i * count : (i + 1) * count], x)
        side = held[i] if held[i] * pull >= 0.0 else 0.0
        if held[i] == 0.0:
            side = -1.0 if x[i] < low[i] else 1.0 if x[i] > high[i] else 0.0
        if side != held[i]:
            held[i] = side
            return True
    return False


# Preview: where the law would leave the limits of the input, the course to come is planned.

MOVES = (0, 1, 2, 4, 8, 16, 32)
"""Slow periods ahead at which what the plan adds to the input changes, and its end."""

AHEAD = MOVES[-1]
"""Slow periods that are planned."""

UNREST = 0.01
"""w: price of an addition to the input over that of the error that it makes in one period."""


def lead_reference(reference: float, last_reference: float, lead: float) -> float:
    """r'[k].

    Args:
        reference: r[k].
        last_reference: r[k-1].
        lead: d, delay of the loop in slow periods; 0 for none.
    """
    return reference + lead * (reference - last_reference)


def led_references(reference: float, last: float, upcoming: Vector, lead: float) -> Vector:
    """Return r'[k] and those to come.

    Args:
        reference: r[k].
        last: r[k-1].
        upcoming: r[k+1] and the following ones.
        lead: d (`slow`).
    """
    known = [last, reference, *upcoming]
    return [lead_reference(known[i], known[i - 1], lead) for i in range(1, len(known))]


def rest(state: ReferenceFilter) -> None:
    """Plan nothing: the course asked for is the one in force."""
    vectors.copy_into(state.ideal, state.course)
    state.offset, state.moved = math.nan, 0.0


def plan(
    state: ReferenceFilter,
    plant: Plant,
    references: Vector,
    last_input: float,
    *,
    free: bool,
    pole: float,
    low: float,
    high: float,
    beyond: float,
) -> float:
    """Return m[k]: that of the law where it keeps the limits.

    Args:
        state: A_m and m[k-1] ... m[k-1-n]; ideal course, offset and movement are overwritten.
        plant: The model.
        references: r'[k] and those to come.
        last_input: u[k-1] as sent.
        free: Whether no limit has changed it: a limit shows from one side only what f may be.
        pole: Pole asked for: f is followed as fast as a set-point.
        low: Lowest input.
        high: Highest input.
        beyond: How far the law may go beyond a limit before its course gives way.
    """
    past, asked = len(state.course), state.asked
    pulled = [vectors.total(asked) * one for one in references]
    law = vectors.follow(asked, state.course, pulled)
    needed = [one / vectors.total(plant.b) for one in vectors.multiply(plant.a, law)]
    added = last_input - needed[past - 1]
    if not math.isfinite(state.offset):
        state.offset = added if free else 0.0
    below, above = last_input <= low, last_input >= high
    if free or (below and added < state.offset) or (above and added > state.offset):
        state.offset += (1.0 - pole) * (added - state.offset)
    ideal = vectors.follow(asked, state.ideal, pulled)
    vectors.shift_in(state.ideal, ideal[past])
    low, high = low - beyond - state.offset, high + beyond - state.offset
    wanted = needed[past : past + AHEAD]
    found = law[past]
    if min(wanted) < low or max(wanted) > high:
        found = _planned(plant, state.course, ideal[past:], wanted, low, high)
        known = [*references, state.course[0]]  # not beyond a level to be nearer to the next
        found = min(max(found, min(known)), max(known))
    state.moved = found - ideal[past]
    return found


def _planned(
    plant: Plant, course: Vector, ideal: Vector, wanted: Vector, low: float, high: float
) -> float:
    """Return m[k] of the plan.

    Args:
        plant: The model.
        course: m[k-1] and those before.
        ideal: The course asked for, from now on.
        wanted: Input of the law less f, from now on.
        low: Lowest input, less f.
        high: Highest input, less f.
    """
    inputs = [min(max(one, low), high) for one in wanted]
    given = _answer(plant, course, inputs)
    gap = [ideal[i] - given[i] for i in range(AHEAD)]
    parts = [inputs[MOVES[j] : MOVES[j + 1]] for j in range(len(MOVES) - 1)]
    lowest, highest = [low - min(part) for part in parts], [high - max(part) for part in parts]
    return given[0] + _added(plant, gap, lowest, highest)


def _added(plant: Plant, gap: Vector, lowest: Vector, highest: Vector) -> float:
    """Return what the plan adds to m[k].

    Args:
        plant: The model.
        gap: The course asked for less that of the limited law, from now on.
        lowest: Least δ between each two changes.
        highest: Largest δ.
    """
    count, rest_course = len(lowest), [0.0] * len(plant.a)
    answers = []
    for j in range(count):
        moved = [1.0 if MOVES[j] <= i < MOVES[j + 1] else 0.0 for i in range(AHEAD)]
        answers.append(_answer(plant, rest_course, moved))
    matrix = [vectors.dot(one, other) for one in answers for other in answers]
    for j in range(0, len(matrix), count + 1):
        matrix[j] += UNREST * plant.gain**2
    right = [vectors.dot(one, gap) for one in answers]
    return answers[0][0] * minimise(matrix, right, lowest, highest)[0]


def _answer(plant: Plant, course: Vector, inputs: Vector) -> Vector:
    """Return how a course, newest first, goes on with these inputs."""
    gained = [vectors.total(plant.b) * one for one in inputs]
    return vectors.follow(plant.a, course, gained)[len(course) :]
