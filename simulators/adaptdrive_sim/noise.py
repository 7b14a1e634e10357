"""Measurement noise on the output: brush noise and spikes.

Random numbers are drawn in blocks and handed out one by one as plain floats: a separate draw
for each sample would cost more than the plant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.parameters import check_quantities, quantity

_BLOCK = 4096


@dataclass(frozen=True, slots=True)
class NoiseParameters:
    """Noise of each fast sample, in the unit of the output."""

    sigma: float = quantity(0.0, "", "standard deviation of every sample", 0.0, 1e6)
    spike_share: float = quantity(0.0, "", "share of samples that carry a spike", 0.0, 1.0)
    spike_sigma: float = quantity(0.0, "", "standard deviation of the spikes", 0.0, 1e6)

    def __post_init__(self) -> None:
        check_quantities(self)

    @property
    def silent(self) -> bool:
        """True if no sample is ever disturbed."""
        return self.sigma == 0.0 and (self.spike_share == 0.0 or self.spike_sigma == 0.0)


def read_spikes(text: str) -> tuple[float, float]:
    """Read the share and the deviation of spikes from a command line.

    Args:
        text: RATE,SIGMA.

    Raises:
        RefusedError: They cannot be read.
    """
    try:
        share, sigma = (float(part) for part in text.split(","))
    except ValueError as problem:
        raise RefusedError(f"spikes {text!r} is not RATE,SIGMA") from problem
    return share, sigma


def samples(parameters: NoiseParameters, generator: np.random.Generator) -> Iterator[float]:
    """Yield the disturbance of one sample after the other, for ever."""
    while True:
        block = parameters.sigma * generator.standard_normal(_BLOCK)
        if parameters.spike_share > 0.0:
            struck = generator.random(_BLOCK) < parameters.spike_share
            block += struck * parameters.spike_sigma * generator.standard_normal(_BLOCK)
        yield from block.tolist()
