"""Responses of a load to a recorded input: exact means over blocks of constant input.

In companion form, x_1' = x_2, ..., x_m' = u - a_m x_1 - ... - a_1 x_m, each state is one term of
the numerator: x_j = s^(j-1) u / D(s). The mean of x over a block of length T follows from the
exponential of the matrix that has ∫x among its states (Van Loan, doi:10.1109/TAC.1978.1101743).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import companion
from scipy.signal import lfilter

Array = NDArray[np.float64]

_TAYLOR_TERMS = 18
"""Terms of the exponential of a matrix of norm 1: 1/19! is below the rounding of a double."""


@dataclass(frozen=True, slots=True)
class Responses:
    """Filters in q^-1 from the input of each block to what the numerator weighs.

    Attributes:
        terms: Numerator of each filter, one for each power of s from m to 0.
        denominator: The denominator of all.
    """

    terms: Array
    denominator: Array

    def of(self, inputs: Array, powers: Sequence[int]) -> Array:
        """Return s^(m-i)/D(s) of an input from rest, a column for each i in `powers`."""
        columns = [lfilter(self.terms[i], self.denominator, inputs) for i in powers]
        return np.column_stack(columns)

    def free(self, count: int) -> Array:
        """Return m functions of time that span all responses without an input."""
        impulse = np.zeros(count)
        impulse[0] = 1.0
        columns = []
        difference = np.ones(1)
        for _ in range(len(self.denominator) - 1):
            columns.append(lfilter(difference, self.denominator, impulse))
            difference = np.convolve(difference, [1.0, -1.0])
        return np.column_stack(columns)


def responses(denominator: Array, period_s: float) -> Responses:
    """Return the exact filters for the means over blocks.

    Args:
        denominator: 1, a_1 ... a_m.
        period_s: Length of a block.
    """
    order = len(denominator) - 1
    matrix = np.zeros((2 * order + 1, 2 * order + 1))
    matrix[:order, :order] = companion(denominator)[::-1, ::-1]
    matrix[order - 1, order] = 1.0
    matrix[order + 1 :, :order] = np.eye(order)
    carried = _exponential(matrix * period_s)
    transition, entry = carried[:order, :order], carried[:order, order]
    mean, direct = carried[order + 1 :, :order] / period_s, carried[order + 1 :, order] / period_s
    below: Array = np.poly(transition).astype(np.float64)
    markov = np.empty((order, order + 1))
    state = entry
    markov[:, 0] = direct
    for k in range(1, order + 1):
        markov[:, k] = mean @ state
        state = transition @ state
    states = np.array([np.convolve(row, below)[: order + 1] for row in markov])
    highest = below - denominator[1:] @ states[::-1]
    return Responses(np.vstack((highest, states[::-1])), below)


def held_step(denominator: Array, period_s: float) -> tuple[Array, Array]:
    """Return transition and entry of the state x in companion form, for a held input.

    Args:
        denominator: 1, a_1 ... a_m.
        period_s: Time for which the input is held.
    """
    order = len(denominator) - 1
    matrix = np.zeros((order + 1, order + 1))
    matrix[:order, :order] = companion(denominator)[::-1, ::-1]
    matrix[order - 1, order] = 1.0
    carried = _exponential(matrix * period_s)
    return carried[:order, :order], carried[:order, order]


def _exponential(matrix: Array) -> Array:
    """Return exp(M) by a Taylor series and repeated squaring.

    scipy's expm uses threads even for five rows: on a busy machine it takes 100 times as long.
    """
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(norm))) if norm > 0.0 else 0
    step = matrix / 2.0**halvings
    result = term = np.eye(len(matrix))
    for n in range(1, _TAYLOR_TERMS + 1):
        term = term @ step / n
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result
