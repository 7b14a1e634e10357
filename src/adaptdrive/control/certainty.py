"""Standard deviations of the physical parameters of a load, from an estimate and its P."""

from __future__ import annotations

import math

from adaptdrive.control import ud_factors as ud
from adaptdrive.control.evidence import PRIOR_SHARE
from adaptdrive.control.load import Load
from adaptdrive.control.regression import filtered_model
from adaptdrive.control.settings import Learning
from adaptdrive.control.vectors import Vector

_TINY = 1e-12
"""Divisor that counts as 0: 4,500 rounding errors of 1."""


def is_sure(
    theta: Vector, upper: Vector, diagonal: Vector, power: float, learning: Learning, load: Load
) -> bool:
    """Return whether every physical parameter is known within half of its value.

    Args:
        theta: θ.
        upper: U.
        diagonal: D.
        power: σ², scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
    """
    numerator, denominator = filtered_model(theta, learning, load)
    if not abs(denominator[load.order]) > _TINY:
        return False
    values = load.physical(numerator, denominator)
    noise = math.sqrt(power)
    deviations = deviations_of(theta, upper, diagonal, noise, learning, load, values)
    for i in range(len(values)):
        if not deviations[i] <= PRIOR_SHARE * abs(values[i]):
            return False
    return True


def deviations_of(
    theta: Vector,
    upper: Vector,
    diagonal: Vector,
    noise: float,
    learning: Learning,
    load: Load,
    values: Vector,
) -> Vector:
    """Standard deviations of the physical parameters at any θ and P, to first order.

    Args:
        theta: θ.
        upper: U.
        diagonal: D.
        noise: σ of the innovations, scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    count = len(theta)
    jacobian = [0.0] * (len(values) * count)
    for j in range(count):
        step = 1e-6 * max(1.0, abs(theta[j]))
        moved = list(theta)
        moved[j] += step
        numerator, denominator = filtered_model(moved, learning, load)
        if not abs(denominator[load.order]) > _TINY:
            return [math.nan] * len(values)
        shifted = load.physical(numerator, denominator)
        for i in range(len(values)):
            jacobian[i * count + j] = (shifted[i] - values[i]) / step
    deviations = [0.0] * len(values)
    for i in range(len(values)):
        row = jacobian[i * count : (i + 1) * count]
        deviations[i] = ud.standard_deviation(row, upper, diagonal, noise)
    return deviations
