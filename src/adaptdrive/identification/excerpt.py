"""An excerpt of a record, and the response of a model to it.

In companion form, x_1' = x_2, ..., x_m' = u - a_m x_1 - ... - a_1 x_m, each state is one term of
the numerator: x_j = s^(j-1) u / D(s). The mean of x over a block of length T follows from the
exponential of the matrix that has ∫x among its states (Van Loan, doi:10.1109/TAC.1978.1101743).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import companion
from scipy.signal import lfilter

from adaptdrive.control.loads.load import Load
from adaptdrive.util.errors import IdentificationError

# Uninterrupted parts of a record, and the means over blocks that a fit works on.

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Uninterrupted part of a record at a constant rate.

    Attributes:
        boost_voltage_V: v_bst at each sample, as it was measured.
        output: y at the same samples.
        period_s: Time between two samples.
        before_V: v_bst before the first sample, None where it is not known: then the samples at
            the start only show what a delayed input was.
        at_rest: Whether the load had come to rest under it.
        held: Whether each voltage acts from its sample to the next, and each output is that of the
            moment; otherwise a sample stands for half a period before and after it.
    """

    boost_voltage_V: Array
    output: Array
    period_s: float
    before_V: float | None = None
    at_rest: bool = False
    held: bool = False

    def __post_init__(self) -> None:
        if len(self.boost_voltage_V) != len(self.output):
            counts = f"{len(self.output)} outputs, but {len(self.boost_voltage_V)} boost voltages"
            raise IdentificationError(counts)
        for name in ("boost_voltage_V", "output"):
            wrong = np.flatnonzero(~np.isfinite(getattr(self, name)))
            if len(wrong):
                raise IdentificationError(f"{name}[{wrong[0]}] is not finite")
        if not self.period_s > 0.0:
            raise IdentificationError(f"period_s = {self.period_s} must be above 0")


@dataclass(frozen=True, slots=True)
class Blocks:
    """Means of an excerpt over blocks of samples.

    A mean over a block of samples is the mean of the signal over the time of the block.

    Attributes:
        fed: Sum of u - `rest` before each sample, from `lead`, `late` and 1 before the first block.
        lead: The longest dead time, in samples.
        late: Samples from the middle of a sample's input to its output, without a dead time.
        outputs: y, mean of each block.
        charge: ∫y dt in the middle of each block.
        samples: Samples in a block.
        period_s: Length of a block.
        rest: u under which the load would rest without a free response.
        at_rest: Whether there is no free response.
    """

    fed: Array
    lead: int
    late: float
    outputs: Array
    charge: Array
    samples: int
    period_s: float
    rest: float
    at_rest: bool

    @property
    def moments(self) -> bool:
        """True where the outputs are those at the end of each block instead of means."""
        return self.late == 1.0

    def inputs(self, delay: float) -> Array:
        """Return the mean of each block of u - `rest` that acts later.

        Args:
            delay: Dead time in samples, at most `lead` + 1; a sample is held for its period.
        """
        first = self.lead + math.ceil(self.late) + 1 - self.late - delay
        edges = first + self.samples * np.arange(len(self.outputs) + 1)
        sums = np.interp(edges, np.arange(len(self.fed)), self.fed)
        means: Array = np.diff(sums) / self.samples
        return means

    def cut(self, rows: slice) -> Blocks:
        """Return some blocks; those after the first do not begin at rest."""
        first = rows.start or 0
        return replace(
            self,
            fed=self.fed[first * self.samples :],
            outputs=self.outputs[rows],
            charge=self.charge[rows],
            at_rest=self.at_rest and first == 0,
        )


def lost_of(excerpt: Excerpt, samples: int, lead: int) -> int:
    """Return how many samples at the start only show what a delayed input was: whole blocks.

    Args:
        excerpt: Part of a record.
        samples: Samples in a block.
        lead: The longest dead time, in samples.
    """
    if excerpt.before_V is not None:
        return 0
    return -(-(lead + math.ceil(_late(excerpt, samples)) + 1) // samples) * samples


def blocks_of(excerpts: Sequence[Excerpt], load: Load, samples: int, lead: int) -> list[Blocks]:
    """Average excerpts over blocks.

    Args:
        excerpts: Parts of a record.
        load: Its input map.
        samples: Samples in a block.
        lead: The longest dead time, in samples. Whole blocks are left out at the start where the
            input before it is not known.
    """
    made = []
    carried = 0.0
    for one in excerpts:
        late, lost = _late(one, samples), lost_of(one, samples, lead)
        before = lead + math.ceil(late) + 1
        volts = one.boost_voltage_V[max(0, lost - before) :]
        if one.before_V is not None:
            volts = np.concatenate((np.full(before, one.before_V), volts))
        fed = load.input_gain * volts**load.input_exponent
        charge = carried + np.cumsum(one.output)[lost:] * one.period_s
        carried = float(charge[-1]) if len(charge) else carried
        made.append(
            Blocks(
                fed=np.concatenate(([0.0], np.cumsum(fed - fed[0]))),
                lead=lead,
                late=late,
                outputs=means_of(one.output[lost:], samples),
                charge=means_of(charge, samples),
                samples=samples,
                period_s=samples * one.period_s,
                rest=float(fed[0]),
                at_rest=one.at_rest,
            )
        )
    return made


def _late(excerpt: Excerpt, samples: int) -> float:
    """Return how far the output of a held input lies behind it: a mean by half a sample."""
    if not excerpt.held:
        return 0.0
    return 1.0 if samples == 1 else 0.5


def means_of(values: Array, samples: int) -> Array:
    """Return means over blocks of samples, of the whole ones."""
    count = len(values) // samples
    means: Array = values[: count * samples].reshape(count, samples).mean(axis=1)
    return means


# Responses of a load to a recorded input: exact means over blocks of constant input.

_TAYLOR_TERMS = 18
"""Terms of the exponential of a matrix of norm 1: 1/19! is below the rounding of a double."""


@dataclass(frozen=True, slots=True)
class Responses:
    """Filters in q^-1 from the input of each block to what the numerator weighs.

    Attributes:
        terms: Numerator of each filter, one for each power of s from m to 0; first those of the
            input of the block, then, where that acts late, those of the block before, which acts
            until the fraction of the dead time is over.
        denominator: The denominator of all.
    """

    terms: tuple[Array, ...]
    denominator: Array

    def of(self, inputs: Sequence[Array], powers: Sequence[int], rest: float = 0.0) -> Array:
        """Return s^(m-i)/D(s) of an input, a column for each i in `powers`.

        Args:
            inputs: The input above that under which the load rests at the start: of each block,
                and of the block before each; that is left out where it does not act.
            powers: The i.
            rest: The input under which it rests.
        """
        made = np.zeros((len(inputs[0]), len(powers)))
        for terms, fed in zip(self.terms, inputs, strict=False):
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
    return Responses((_terms(denominator, below, course, 1.0),), below)


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
    return Responses(tuple(made), below)


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
