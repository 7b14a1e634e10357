"""Uninterrupted parts of a record, and the means over blocks that a fit works on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.loads.load import Load
from adaptdrive.util.errors import IdentificationError

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
                outputs=_means(one.output[lost:], samples),
                charge=_means(charge, samples),
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


def _means(values: Array, samples: int) -> Array:
    count = len(values) // samples
    means: Array = values[: count * samples].reshape(count, samples).mean(axis=1)
    return means
