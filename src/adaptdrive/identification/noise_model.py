"""An autoregressive model of what the load does not explain: A(q) v = e."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SAMPLES_PER_TERM = 10
"""Samples of the longest part for each term that is tried."""


def autoregression(parts: Sequence[Array], most: int = 8) -> Array:
    """Return 1, A_1 ... A_n with the n of least Bayesian information criterion.

    Args:
        parts: v of each uninterrupted part.
        most: Order up to which a model is tried.
    """
    longest = min(most, max(map(len, parts)) // _SAMPLES_PER_TERM)
    usable = [part for part in parts if len(part) > 2 * longest]
    count = sum(len(part) - longest for part in usable)
    lags = [np.lib.stride_tricks.sliding_window_view(part, longest + 1) for part in usable]
    rows = np.concatenate(lags)[:, ::-1]
    scores = [_score(rows, order, count) for order in range(longest + 1)]
    return min(scores, key=operator.itemgetter(0))[1]


def _score(rows: Array, order: int, count: int) -> tuple[float, Array]:
    """Return criterion and coefficients of one order."""
    targets, past = rows[:, 0], rows[:, 1 : order + 1]
    factors = np.linalg.lstsq(past, targets)[0]
    rest = targets - past @ factors
    power = max(float(rest @ rest), 1e-300)
    return count * math.log(power) + order * math.log(count), np.concatenate(([1.0], -factors))
