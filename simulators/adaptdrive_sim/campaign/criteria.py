"""Criteria that every load shares: the cost of a run, and what counts as unstable or worse.

The cost of a controller is the squared error against the loop as it was designed, summed over the
slow instants, plus (0.005 · step)² for each: errors below any display cost nothing relative to
that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptdrive_sim.campaign.drawn import Row

Array = NDArray[np.float64]

FLOOR = 0.005
WORSE = 1.05
UNSTABLE = 0.5
"""Of the largest movement that is expected: rms error at the end of an unstable run."""


def cost(errors: Array) -> float:
    """Mean squared error, as a fraction of the step, with the floor; infinite if it ended early."""
    if not np.all(np.isfinite(errors)):
        return float("inf")
    return float(np.mean(errors**2)) + FLOOR**2


def rms(errors: Array) -> float:
    """Return the root of the mean squared error."""
    return float(np.sqrt(np.mean(errors**2)))


def error_columns(name: str, errors: Array) -> Row:
    """Return the columns of one controller's errors.

    Args:
        name: The controller.
        errors: Differences to the designed loop, as fractions of the step.
    """
    return {
        f"cost_{name}": cost(errors),
        f"rms_{name}": rms(errors),
        f"largest_{name}": float(np.max(np.abs(errors))),
    }
