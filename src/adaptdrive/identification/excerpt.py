"""Uninterrupted parts of a record, and the means over blocks that a fit works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.load import Load
from adaptdrive.errors import IdentificationError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Uninterrupted part of a record at a constant rate.

    Attributes:
        boost_voltage_V: v_bst at each sample, as it was measured.
        output: y at the same samples.
        period_s: Time between two samples.
    """

    boost_voltage_V: Array
    output: Array
    period_s: float

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

    A mean over a block of samples is the mean of the signal over the time of the block: a sample
    stands for half a period before and after it.

    Attributes:
        inputs: u, delayed by the dead time, mean of each block.
        outputs: y, mean of each block.
        charge: ∫y dt in the middle of each block.
        period_s: Length of a block.
    """

    inputs: Array
    outputs: Array
    charge: Array
    period_s: float


def blocks_of(
    excerpts: Sequence[Excerpt], load: Load, samples: int, delay: int, longest_delay: int
) -> list[Blocks]:
    """Average excerpts over blocks.

    Args:
        excerpts: Parts of a record.
        load: Its input map.
        samples: Samples in a block.
        delay: Samples by which the output lags behind the input, besides the load's own lag.
        longest_delay: The longest `delay`; whole blocks are left out at the start, so that the
            result has the same outputs for each delay.
    """
    made = []
    carried = 0.0
    lost = -(-longest_delay // samples) * samples
    for one in excerpts:
        volts = one.boost_voltage_V[lost - delay : len(one.boost_voltage_V) - delay]
        outputs = one.output[lost:]
        charge = carried + np.cumsum(one.output)[lost:] * one.period_s
        carried = float(charge[-1]) if len(charge) else carried
        inputs = load.input_gain * volts**load.input_exponent
        means = [_means(values, samples) for values in (inputs, outputs, charge)]
        made.append(Blocks(means[0], means[1], means[2], samples * one.period_s))
    return made


def _means(values: Array, samples: int) -> Array:
    count = len(values) // samples
    means: Array = values[: count * samples].reshape(count, samples).mean(axis=1)
    return means
