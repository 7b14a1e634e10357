"""Reference filter: the response that is asked for, from a loop that may have other poles.

    m[k]  = A_m(1)/A_m r'[k]              course of the ideal loop, without the zeros of B
    r"[k] = A_c/A_c(1) m[k]               u = (t0 r" - S y) / R,  t0 = S(1)

With t0 = A_c(1)/B(1) the output is B/B(1) m: that of the loop with the poles A_m, whatever A_c is.
With A_c = A_m the filter is 1.

Where the input is limited to u_lim, r" + (u_lim - u)/t0 would have asked for it, and the course is
set to the one that belongs to it (R. Hanus, M. Kinnaert and J.-L. Henrotte, Automatica 23, 1987,
doi:10.1016/0005-1098(87)90029-X). It continues from what the load can do, and nothing winds up. A
drive that did not follow, such as one whose V_c falls only as the load discharges it, is a limit as
well: one that is known a slow period later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.vectors import Vector, all_finite, copy_into, dot, shift_in, total


@dataclass(slots=True)
class ReferenceFilter:
    """Reference filter of the adaptive law.

    Attributes:
        asked: A_m; zeros before there is a design.
        loop: A_c.
        course: m[k] ... m[k-n].
    """

    asked: Vector
    loop: Vector
    course: Vector


def new_reference_filter(order: int, taps: int) -> ReferenceFilter:
    """Return a filter without a design, whose course begins at the first reference."""
    count = order + taps + 1
    return ReferenceFilter([0.0] * (2 * order + 1), [0.0] * count, [math.nan] * count)


def filter_reference(state: ReferenceFilter, reference: float, planned: float = math.nan) -> float:
    """Return r"[k].

    Args:
        state: Overwritten.
        reference: r'[k].
        planned: m[k] where it is planned (`preview`), else NaN.
    """
    if total(state.loop) == 0.0 or not all_finite(state.course):
        copy_into(state.course, [reference] * len(state.course))
        return reference
    course = total(state.asked) * reference
    for i in range(1, len(state.asked)):
        course -= state.asked[i] * state.course[i - 1]
    shift_in(state.course, planned if math.isfinite(planned) else course)
    return reference_of(state.loop, state.course)


def reference_of(loop: Vector, course: Vector) -> float:
    """Return r"[k] for a loop A_c."""
    return dot(loop, course) / total(loop)


def condition_reference(state: ReferenceFilter, shortage: float, gain: float) -> None:
    """Set the course to the one that asks for no more than the input gives.

    Args:
        state: Overwritten.
        shortage: Limited input minus the one that was asked for.
        gain: t0 of the law.
    """
    if gain != 0.0:
        state.course[0] += shortage / gain * total(state.loop)
