"""A quadratic function of a few numbers, each between the same limits.

    min ½ xᵀ H x - hᵀ x,  low <= x <= high

by the method of active limits (J. Nocedal and S. J. Wright, Numerical Optimization, 2006, section
16.5): those numbers that are not held at a limit go towards the minimum over them, as far as the
first limit. Where they have reached it, the one that pulls most from its limit is let go. Each step
is exact, and none leaves the limits or makes the function larger; the steps are bounded.
"""

from __future__ import annotations

from adaptdrive.control.vectors import Vector, solve_linear

_STEPS = 4
"""Steps for each number; about one and a half are needed."""


def minimise(matrix: Vector, right: Vector, low: float, high: float) -> Vector:
    """Return the x of the least function.

    Args:
        matrix: H, symmetric and positive definite, flat.
        right: h.
        low: Lowest x.
        high: Highest x.
    """
    count = len(right)
    x, held = [0.5 * (low + high)] * count, [0.0] * count
    for _ in range(_STEPS * count):
        way = _way(matrix, right, x, held)
        share, first = 1.0, -1
        for i in range(count):
            room = (high if way[i] > 0.0 else low) - x[i]
            if share * abs(way[i]) > abs(room):
                share, first = room / way[i], i
        for i in range(count):
            x[i] = min(max(x[i] + share * way[i], low), high)
        if first >= 0:
            held[first] = 1.0 if way[first] > 0.0 else -1.0
            x[first] = high if way[first] > 0.0 else low
        elif not _let_go(matrix, right, x, held):
            break
    return x


def _way(matrix: Vector, right: Vector, x: Vector, held: Vector) -> Vector:
    """Return the way to the minimum over the numbers that are not held."""
    count = len(right)
    part, pull = [0.0] * (count * count), [0.0] * count
    for i in range(count):
        part[i * count + i] = 1.0
        if held[i] == 0.0:
            pull[i] = _pull(matrix, right, x, i)
            for j in range(count):
                if held[j] == 0.0:
                    part[i * count + j] = matrix[i * count + j]
    return solve_linear(part, pull)


def _pull(matrix: Vector, right: Vector, x: Vector, i: int) -> float:
    """Return how much the function falls with one number."""
    result = right[i]
    for j in range(len(x)):
        result -= matrix[i * len(x) + j] * x[j]
    return result


def _let_go(matrix: Vector, right: Vector, x: Vector, held: Vector) -> bool:
    """Let go of the number that pulls most from its limit; False where none does."""
    worst, most = -1, 0.0
    for i in range(len(x)):
        pull = -held[i] * _pull(matrix, right, x, i)
        if pull > most:
            worst, most = i, pull
    if worst >= 0:
        held[worst] = 0.0
    return worst >= 0
