"""A frame that carries a part of the command."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from adaptdrive.control.signals import Command
from adaptdrive.hardware.link.codec import MessageCodec


@dataclass(frozen=True, slots=True)
class Part:
    """One field of `Command` on its way into a signal: base + factor × field.

    Attributes:
        field: Field of `Command`.
        signal: Name of the signal.
        base: Value of the signal where the field is 0 or False.
        factor: Units of the signal per unit of the field.
    """

    field: str
    signal: str
    base: float
    factor: float

    def value(self, command: Command) -> float:
        """The signal's value, in the unit of the DBC."""
        return self.base + self.factor * float(getattr(command, self.field))

    def field_value(self, value: float) -> float:
        """The field that a value of the signal stands for."""
        return (value - self.base) / self.factor


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame that carries a part of the command.

    Attributes:
        codec: Codec of its message; frames of one message share it, and its alive counter.
        parts: What is taken from the command.
        fixed: Values that are always the same: constants, and what selects the page.
    """

    codec: MessageCodec
    parts: tuple[Part, ...]
    fixed: Mapping[str, float]

    @property
    def switches_bridge(self) -> bool:
        """True if it carries the bridge."""
        return any(part.field == "bridge" for part in self.parts)

    def encode(self, command: Command) -> bytes:
        """Make the next frame.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it.
        """
        values = dict(self.fixed)
        for part in self.parts:
            values[part.signal] = part.value(command)
        return self.codec.encode(values)


def bridge_first(orders: Iterable[CommandFrame]) -> tuple[CommandFrame, ...]:
    """Return frames in their order, those that carry the bridge first: a bus may take one alone."""
    return tuple(sorted(orders, key=lambda order: not order.switches_bridge))
