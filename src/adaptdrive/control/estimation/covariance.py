"""Standard deviations of the physical parameters of a load, from an estimate and its P."""

from __future__ import annotations

import math

from adaptdrive.control.estimation import ud_factors as ud
from adaptdrive.control.estimation.branch import Branch
from adaptdrive.control.estimation.regression import filtered_model
from adaptdrive.control.loads.load import Load
from adaptdrive.control.settings import Learning
from adaptdrive.control.thresholds import PRIOR_SHARE
from adaptdrive.control.vectors import Vector

_TINY = 1e-12
"""Divisor that counts as 0: 4,500 rounding errors of 1."""


def is_sure(branch: Branch, power: float, learning: Learning, load: Load) -> bool:
    """Return whether every physical parameter is known within half of its value.

    Args:
        branch: θ and P.
        power: σ², scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
    """
    numerator, denominator = filtered_model(branch.theta, learning, load)
    if not abs(denominator[load.order]) > _TINY:
        return False
    values = load.physical(numerator, denominator)
    deviations = deviations_of(branch, math.sqrt(power), learning, load, values)
    return all(deviations[i] <= PRIOR_SHARE * abs(values[i]) for i in range(len(values)))


def deviations_of(
    branch: Branch, noise: float, learning: Learning, load: Load, values: Vector
) -> Vector:
    """Standard deviations of the physical parameters at any θ and P, to first order.

    Args:
        branch: θ and P.
        noise: σ of the innovations, scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    count, rows = len(branch.theta), _jacobian(branch.theta, learning, load, values)
    deviations = [math.nan] * len(values)
    if not math.isfinite(rows[0]):
        return deviations
    for i in range(len(values)):
        row = rows[i * count : (i + 1) * count]
        deviations[i] = ud.standard_deviation(row, branch.upper, branch.diagonal, noise)
    return deviations


def root_of(branch: Branch, noise: float, learning: Learning, load: Load, values: Vector) -> Vector:
    """L, lower triangular, flat, of the covariance L Lᵀ of the physical parameters.

    Args:
        branch: θ and P.
        noise: σ of the innovations, scaled.
        learning: Scales.
        load: Names and meaning of the parameters.
        values: The parameters at θ.
    """
    size, count = len(values), len(branch.theta)
    rows = _jacobian(branch.theta, learning, load, values)
    known = ud.covariance(branch.upper, branch.diagonal)
    root = [0.0] * (size * size)
    for i in range(size):
        for j in range(i + 1):
            rest = 0.0
            for m in range(count):
                for n in range(count):
                    rest += rows[i * count + m] * known[m * count + n] * rows[j * count + n]
            rest *= noise * noise
            whole = rest
            for m in range(j):
                rest -= root[i * size + m] * root[j * size + m]
            if i == j:
                root[i * size + i] = math.sqrt(rest) if not rest < _TINY * whole else 0.0
            elif root[j * size + j] > 0.0:
                root[i * size + j] = rest / root[j * size + j]
    return root


def _jacobian(theta: Vector, learning: Learning, load: Load, values: Vector) -> Vector:
    """Derivatives of the physical parameters by θ, a row for each; NaN without a dc gain."""
    count = len(theta)
    rows = [0.0] * (len(values) * count)
    for j in range(count):
        step = 1e-6 * max(1.0, abs(theta[j]))
        moved = list(theta)
        moved[j] += step
        numerator, denominator = filtered_model(moved, learning, load)
        if not abs(denominator[load.order]) > _TINY:
            return [math.nan] * len(rows)
        shifted = load.physical(numerator, denominator)
        for i in range(len(values)):
            rows[i * count + j] = (shifted[i] - values[i]) / step
    return rows
