"""The dead time of a load: the one with which a fit leaves the least."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from adaptdrive.identification.fit import Problem, Solution, refine
from adaptdrive.identification.starts import start

Array = NDArray[np.float64]

_FINEST = 0.01
"""Distance in blocks at which the search ends."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fit with the dead time that suits it best.

    Attributes:
        problem: Data, structure and dead time.
        solution: The fit.
    """

    problem: Problem
    solution: Solution


def scan(problem: Problem, *near: Array) -> Fitted:
    """Return the best fit with a dead time of whole blocks.

    Args:
        problem: Data and structure.
        near: Logarithms of a_1 ... a_m from which a fit may start.
    """
    lead, samples = problem.parts[0].lead, problem.parts[0].samples
    delays = np.linspace(0.0, lead, 1 + math.ceil(lead / samples)).tolist()
    delayed = [replace(problem, delay=delay) for delay in delays]
    return min((Fitted(one, refine(one, start(one, *near))) for one in delayed), key=_loss)


def settle(problem: Problem, logarithms: Array) -> Fitted:
    """Return the best fit with a dead time within a block of that of a problem.

    Args:
        problem: Data, structure, and the dead time near which it is searched.
        logarithms: Of a_1 ... a_m from which each fit starts.
    """
    lead, samples = problem.parts[0].lead, problem.parts[0].samples
    near = _fitted(problem, problem.delay, logarithms)
    if lead == 0:
        return near
    found = minimize_scalar(
        lambda delay: _fitted(problem, delay, near.solution.logarithms).solution.loss,
        bounds=(max(0.0, problem.delay - samples), min(lead, problem.delay + samples)),
        method="bounded",
        options={"xatol": _FINEST * samples},
    )
    delays = (float(found.x), float(round(found.x)))
    others = [_fitted(problem, delay, near.solution.logarithms) for delay in delays]
    return min((near, *others), key=_loss)


def _fitted(problem: Problem, delay: float, logarithms: Array) -> Fitted:
    delayed = replace(problem, delay=delay)
    return Fitted(delayed, refine(delayed, logarithms))


def _loss(fitted: Fitted) -> float:
    return fitted.solution.loss
