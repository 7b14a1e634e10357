"""Values that the description of a drive must be able to carry."""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.config import Configuration
from adaptdrive.control.signals import Command

_ROUNDING = 1e-6
"""Share of one count by which an integer may be missed in binary."""


@dataclass(frozen=True, slots=True)
class Demands:
    """Requirements of the limits of a configuration on its signals.

    Attributes:
        output_unit: Unit of the regulated quantity, empty where it has none.
        commands: Commands at the ends of their limits; each must be sent as it is.
    """

    output_unit: str = ""
    commands: tuple[Command, ...] = ()

    def values(self, field: str) -> list[float]:
        """The ends of one field of the command."""
        return [float(getattr(command, field)) for command in self.commands]


NO_DEMANDS = Demands()


def demands_of(configuration: Configuration) -> Demands:
    """Return what the limits of a configuration ask of its signals."""
    limits, lowest_S, scale_S = configuration.drive.limits, 0.0, 0.0
    if configuration.voltage_loop.where == "daemon":
        scale_S = limits.current_scale_max_S
        lowest_S = configuration.drive.current_scale_min_S
    return Demands(
        output_unit=configuration.load.output_unit,
        commands=(
            Command(lowest_S, limits.boost_reference_min_V, bridge=True),
            Command(scale_S, limits.boost_reference_max_V, bridge=True),
        ),
    )


def is_whole(count: float) -> bool:
    """Return whether a number of counts is an integer, but for what it misses in binary.

    Args:
        count: The number.
    """
    return math.isclose(count, round(count), rel_tol=0.0, abs_tol=_ROUNDING)
