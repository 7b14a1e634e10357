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
        inertias: Inertia in each slow period, in kg m².
        disturbances: Measurement noise of every tick, and of one more.
        mode: Controller asked for.
        pole: Closed-loop pole.
    """

    references: Array
    inertias: Array
    disturbances: Array
    mode: Mode
    pole: float


@dataclass(frozen=True, slots=True)
class Interlocks:
    """Trip levels that matter without a bus."""

    boost_voltage_max_V: float
    output_max: float
