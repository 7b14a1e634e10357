"""Values that the description of a drive must be able to carry."""

from __future__ import annotations

from dataclasses import dataclass

from adaptdrive.control.signals import Command


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
