"""Denominators from which a fit starts, and the limits within which it searches."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control import batch
from adaptdrive.identification.fit import Problem, limits, solve

Array = NDArray[np.float64]

_POINTS = 3000
"""Most points of the λ-method's record."""

_TRIED = 6
"""Time constants that are tried, of the λ filters and of the load."""


def start(problem: Problem) -> Array:
    """Logarithms of a_1 ... a_m that fit best among the λ-method's and plain time constants."""
    low, high = limits(problem)
    tried = [np.clip(one, low, high) for one in (*_by_lambda(problem), *_by_grid(problem))]
    return min(tried, key=lambda logarithms: solve(problem, logarithms).loss)


def _by_lambda(problem: Problem) -> list[Array]:
    """Estimates of the λ-method with several time constants of its filters."""
    part = max(problem.parts, key=lambda one: len(one.outputs))
    count = math.ceil(len(part.outputs) / _POINTS)
    rows = len(part.outputs) // count
    outputs = part.outputs[: rows * count].reshape(rows, count).mean(axis=1)
    inputs = part.inputs[: rows * count].reshape(rows, count).mean(axis=1)
    period_s = count * part.period_s
    record = batch.Record(outputs.tolist(), inputs.tolist(), period_s)
    structure = batch.Structure(problem.order, direct=0 in problem.powers, bias=True)
    found = []
    for tau_s in np.geomspace(2.0 * period_s, 0.2 * period_s * rows, _TRIED).tolist():
        denominator = batch.identify(record, structure, tau_s).denominator
        if (denominator[1:] > 0.0).all():
            found.append(np.log(denominator[1:]))
    return found


def _by_grid(problem: Problem) -> list[Array]:
    """Denominators of real time constants from half a block to half the record."""
    block_s = problem.parts[0].period_s
    taus_s = np.geomspace(0.5 * block_s, 0.5 * block_s * len(problem.targets), _TRIED)
    groups = itertools.combinations_with_replacement(taus_s.tolist(), problem.order)
    return [np.log(np.poly([-1.0 / tau_s for tau_s in group])[1:]) for group in groups]
