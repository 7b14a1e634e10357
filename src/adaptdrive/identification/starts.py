"""Denominators from which a fit starts."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from adaptdrive.identification.fit import Problem, limits, solve

Array = NDArray[np.float64]

_TRIED = 6
"""Time constants that are tried, from half a block to half the record."""


def start(problem: Problem, *near: Array) -> Array:
    """Return logarithms of a_1 ... a_m that fit best among some and those of real time constants.

    Args:
        problem: Data and structure.
        near: Logarithms that are tried too.
    """
    block_s = problem.parts[0].period_s
    taus_s = np.geomspace(0.5 * block_s, 0.5 * block_s * len(problem.targets), _TRIED)
    groups = itertools.combinations_with_replacement(taus_s.tolist(), problem.order)
    plain = [np.log(np.poly([-1.0 / tau_s for tau_s in group])[1:]) for group in groups]
    low, high = limits(problem)
    tried = [np.clip(one, low, high) for one in (*near, *plain)]
    return min(tried, key=lambda logarithms: solve(problem, logarithms).loss)
