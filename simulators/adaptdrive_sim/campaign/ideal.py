"""The loop as it was designed: true load, no limits, delays or noise."""

from collections.abc import Sequence

import numpy as np

from adaptdrive.control.design.pole_placement import desired_polynomial
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.vectors import Vector, total
from adaptdrive_sim.course import Array


def follow_ideal(references: Array, loads: Sequence[Load], pole: float, period_s: float) -> Array:
    """Follow set-points with the loop as it was designed.

    Args:
        references: r[k].
        loads: The true load in each slow period; all of one order.
        pole: Closed-loop pole.
        period_s: T_k.

    Returns:
        y[k], from rest on the first reference.
    """
    desired = desired_polynomial(pole, 2 * loads[0].order)
    first = float(references[0])
    moves = (references - first).tolist()
    weights: Vector = []
    outputs = [0.0] * len(moves)
    for k, load in enumerate(loads):
        if k == 0 or _differ(load, loads[k - 1]):
            weights = _weights(load, desired, period_s)
        for i in range(min(k + 1, len(weights))):
            outputs[k] += weights[i] * moves[k - i]
        for i in range(1, min(k + 1, len(desired))):
            outputs[k] -= desired[i] * outputs[k - i]
    return np.array(outputs) + first


def _weights(load: Load, desired: Vector, period_s: float) -> Vector:
    """A_m(1)/B(1) · B."""
    _, b = held_model(list(load.numerator), list(load.denominator), period_s, 0.0, 0.0)
    scale = total(desired) / total(b)
    return [one * scale for one in b]


def _differ(one: Load, other: Load) -> bool:
    return (one.numerator, one.denominator) != (other.numerator, other.denominator)
