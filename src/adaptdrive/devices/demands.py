"""Values that the description of a drive must be able to carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from adaptdrive.config import Configuration
from adaptdrive.config.units import WANTED
from adaptdrive.control.signals import Command


@dataclass(frozen=True, slots=True)
class Demands:
    """Requirements of the limits of a configuration on its signals.

    Attributes:
        output_unit: Unit of the regulated quantity, empty where it has none.
        drive_unit: Unit of what the drive is commanded, and gives.
        commands: Commands at the ends of their limits; each must be sent as it is.
        trips: Key of the value above which each quantity trips, and the value; the signal must
            be able to show more.
    """

    output_unit: str = ""
    drive_unit: str = "V"
    commands: tuple[Command, ...] = ()
    trips: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def unit_of(self, quantity: str) -> str:
        """The unit of a quantity, empty for one of any unit."""
        if quantity in {"boost_voltage_V", "boost_reference_V"}:
            return self.drive_unit
        return self.output_unit if quantity == "output" else WANTED.get(quantity, "")


NO_DEMANDS = Demands()


def demands_of(configuration: Configuration) -> Demands:
    """Return what the limits of a configuration ask of its signals."""
    limits, trips = configuration.drive.limits, configuration.interlocks
    in_daemon = configuration.voltage_loop.where == "daemon"
    lowest_S = configuration.drive.current_scale_min_S if in_daemon else 0.0
    scale_S = limits.current_scale_max_S if in_daemon else 0.0
    return Demands(
        output_unit=configuration.load.output_unit,
        drive_unit=configuration.drive.manipulated.unit,
        commands=(
            Command(lowest_S, limits.boost_reference_min_V, bridge=True),
            Command(scale_S, limits.boost_reference_max_V, bridge=True),
        ),
        trips={
            "boost_voltage_V": ("boost_voltage_max_V", trips.boost_voltage_max_V),
            "output": ("output_max", trips.output_max),
        },
    )
