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
        late_terms: The same for the input of the block before, which acts until the fraction of the
            dead time is over; None where the input of a block is a mean.
        denominator: The denominator of all.
    """

    terms: Array
    late_terms: Array | None
    denominator: Array

    def of(
        self, inputs: Array, powers: Sequence[int], rest: float = 0.0, late: Array | None = None
    ) -> Array:
        """Return s^(m-i)/D(s) of an input, a column for each i in `powers`.

        Args:
            inputs: The input above that under which the load rests at the start.
            powers: The i.
            rest: That input.
            late: The input of the block before each, for `late_terms`.
        """
        pairs = [(self.terms, inputs)]
        if self.late_terms is not None and late is not None:
            pairs.append((self.late_terms, late))
        made = np.zeros((len(inputs), len(powers)))
        for terms, fed in pairs:
            for column, i in enumerate(powers):
                steady = rest * terms[i].sum() / self.denominator.sum()
                made[:, column] += steady + lfilter(terms[i], self.denominator, fed)
        return made

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
    course = [direct]
    for _ in range(order):
        course.append(mean @ entry)
        entry = transition @ entry
    return Responses(_terms(denominator, below, course, 1.0), None, below)


def moment_responses(denominator: Array, period_s: float, fraction: float) -> Responses:
    """Return the exact filters for the ends of blocks, when the input of each acts later.

    Args:
        denominator: 1, a_1 ... a_m.
        period_s: Length of a block.
        fraction: Share of a block by which it acts later, from 0 to below 1.
    """
    transition, _ = held_step(denominator, period_s)
    below: Array = np.poly(transition).astype(np.float64)
    rest, entry = held_step(denominator, (1.0 - fraction) * period_s)
    _, early = held_step(denominator, fraction * period_s)
    made = []
    for unit, state in ((1.0, entry), (0.0, rest @ early)):
        course = [state]
        for _ in range(len(denominator) - 1):
            course.append(transition @ course[-1])
        made.append(_terms(denominator, below, course, unit))
    return Responses(made[0], made[1], below)


def _terms(denominator: Array, below: Array, course: Sequence[Array], unit: float) -> Array:
    """Return the numerators for a course of the state after an input of 1 in one block.

    Args:
        denominator: 1, a_1 ... a_m.
        below: Denominator in q^-1.
        course: The state in this block and the next ones.
        unit: The input that acts at the moment of the output, over that of the block.
    """
    order = len(denominator) - 1
    rows = np.array(course).T
    states = np.array([np.convolve(row, below)[: order + 1] for row in rows])
    highest = unit * below - denominator[1:] @ states[::-1]
    return np.vstack((highest, states[::-1]))


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
