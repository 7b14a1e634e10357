"""What a run is given besides controller and plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptdrive.control.signals import Mode

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Course:
    """What happens in the course of a run.

    Attributes:
        references: r[k].
        sizes: Size that the load is to have in each slow period, as a multiple of the nominal one.
        over_s: How long a change of it takes.
        disturbances: Measurement noise of every tick, and of one more.
        mode: Controller asked for.
        pole: Closed-loop pole.
    """

    references: Array
    sizes: Array
    over_s: float
    disturbances: Array
    mode: Mode
    pole: float


@dataclass(frozen=True, slots=True)
class Interlocks:
    """Trip levels that matter without a bus."""

    boost_voltage_max_V: float
    output_max: float
