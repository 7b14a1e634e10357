"""Messages of a drive on CAN: what each carries, their values put together, and refused frames."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from adaptdrive.control.signals import Command
from adaptdrive.devices import description, port
from adaptdrive.devices.binding import BRIDGE
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.integrity import FrameVerdict
from adaptdrive.safety.timing import Timing
from adaptdrive.util.errors import Flaw

# What the messages of a drive carry.

_NOTHING: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class StatusFrame:
    """A message that carries measurements, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[description.Source[Any], ...]

    def quantities(self, found: Mapping[str, float]) -> dict[str, float]:
        """Return values by quantity.

        Args:
            found: Good values by signal, which is the name of the field of a source.
        """
        values = {}
        for one in self.sources:
            value = found.get(one.field.name)
            if value is not None:
                values[one.quantity] = value * one.scale + one.offset
        return values


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame that carries a part of the command.

    Attributes:
        codec: Codec of its message; frames of one message share it, and its alive counter.
        parts: What is taken from the command, by signal.
        fixed: Values that are always the same: constants, and what selects the page.
        copies: Values besides the command, such as measured ones that are sent back, by signal.
        every_s: Time from one to the next where it does not go with each command.
    """

    codec: MessageCodec
    parts: Mapping[str, description.Sink[Any]]
    fixed: Mapping[str, float]
    copies: Mapping[str, description.Sink[Any]]
    every_s: float = 0.0

    def encode(self, command: Command, measured: Mapping[str, float] = _NOTHING) -> bytes:
        """Make the next frame.

        Args:
            command: The command.
            measured: Values by name; a copy of one that is missing, or does not fit into its
                signal, says that it is not available.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it.
        """
        values: dict[str, float | None] = dict(self.fixed)
        for signal, part in self.parts.items():
            values[signal] = part.value(command)
        for signal, copy in self.copies.items():
            value = copy.base + copy.factor * measured.get(copy.name, math.nan)
            values[signal] = None if copy.field.problem(value) else value
        return self.codec.encode(values)


def bridge_first(orders: Iterable[CommandFrame]) -> tuple[CommandFrame, ...]:
    """Return frames in their order, those that carry the bridge first: a bus may take one alone."""
    return tuple(
        sorted(orders, key=lambda order: all(one.name != BRIDGE for one in order.parts.values()))
    )


@dataclass(frozen=True, slots=True)
class CanMapping:
    """Messages and properties of one drive, for its port.

    Attributes:
        sources: Where each of its values comes from.
        statuses: Messages with measurements.
        orders: Frames of the command, in the order of sending.
        setup: Frames that are sent once, when the bus is opened.
        clock: Message whose arrival is the fast tick.
        page: Signal whose page of that message alone is it, None for all its frames.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
        cautions: What can be used, and is probably not meant.
        timing: Times of the drive.
    """

    sources: tuple[description.Source[Any], ...]
    statuses: tuple[StatusFrame, ...]
    orders: tuple[CommandFrame, ...]
    setup: tuple[CommandFrame, ...]
    clock: str
    page: str | None
    counter_modulus: int | None
    timing: Timing
    cautions: tuple[Flaw, ...]


# Putting the status messages of a drive together: the newest good value of each quantity.


class StatusAssembly:
    """The newest values of one drive, and the readings that are made of them.

    Attributes:
        newest: The values, by quantity.
        bridge: Source of the report of the bridge, None for a drive that never reports it.
    """

    def __init__(self, mapping: CanMapping) -> None:
        self._statuses = mapping.statuses
        self._sources = {
            one.quantity: (status, one) for status in mapping.statuses for one in status.sources
        }
        self.bridge = self._sources.get(BRIDGE, (None, None))[1]
        self.newest = port.NewestValues(mapping.sources)

    def forget(self) -> None:
        """Await a report of the bridge: the bus was opened again; counters may have advanced."""
        for status in self._statuses:
            status.codec.resume()
        self.newest.forget("bridge")

    def keep(
        self,
        status: StatusFrame,
        found: Mapping[str, float],
        arrival_s: float,
        *,
        whole: bool = True,
    ) -> bool | None:
        """Keep the good values of a message; return its report of the bridge, None for none.

        Args:
            status: The message.
            found: Good values by signal.
            arrival_s: Arrival by the monotonic clock.
            whole: Whether they are all of its values.
        """
        values = self._quantities(status, found)
        expected = () if whole else status.sources
        refused = [one.quantity for one in expected if one.quantity not in values]
        self.newest.keep(values, arrival_s, refused)
        return _reported(values)

    def look_at(self, status: StatusFrame, found: Mapping[str, float]) -> bool | None:
        """Keep the faults of a message that may be an old one; return its bridge, None for none.

        Args:
            status: The message.
            found: Good values by signal.
        """
        values = self._quantities(status, found)
        self.newest.faults.see(values)
        return _reported(values)

    def _quantities(self, status: StatusFrame, found: Mapping[str, float]) -> dict[str, float]:
        """Return the values of a message by quantity; the bridge is 1 while it is on."""
        values = status.quantities(found)
        if self.bridge is not None and BRIDGE in values:
            values[BRIDGE] = float(values[BRIDGE] == self.bridge.on)
        return values

    def oldest(self) -> tuple[StatusFrame, description.Source[Any], float, float]:
        """Return the value that is out of date first: its message, its source, and its arrival.

        The last item is the arrival of the newest value; an arrival is -inf before the first.
        """
        quantity, oldest_s, newest_s = self.newest.oldest()
        return *self._sources[quantity], oldest_s, newest_s


def _reported(values: Mapping[str, float]) -> bool | None:
    """Return whether the bridge is on by some values, None where none of them is its report."""
    return values[BRIDGE] != 0.0 if BRIDGE in values else None


# Frames that a port could not use, kept for reports: which, why, and how often.

_KINDS_HELD = 64
"""Kinds of refused frames remembered: a flood of ids must not fill the memory."""

_REMEDIES = {
    FrameVerdict.WRONG_LENGTH: "DLC {0}, needed {1}: the DBC describes another version "
    "of the message",
    FrameVerdict.WRONG_CHECKSUM: "compare [bus.integrity] with the drive's manual; "
    "look at the cable",
    FrameVerdict.COUNTER_STUCK: "its sender hangs, or a gateway repeats frames",
    FrameVerdict.COUNTER_LOST: "frames are lost: check the bus load and the cable",
    FrameVerdict.OUT_OF_RANGE: "{2}; a sensor of the drive is broken, or the DBC has "
    "another sign or range",
}


@dataclass(slots=True)
class _Refusal:
    """One kind: how often since the start and since the last good frame, and the last frame."""

    count: int = 0
    in_a_row: int = 0
    data: bytes = b""
    codec: MessageCodec | None = None


class Refusals:
    """Refused frames of each message, and frames that are not of this drive."""

    def __init__(self) -> None:
        self._seen: dict[str, dict[FrameVerdict | None, _Refusal]] = {}

    @property
    def any(self) -> bool:
        """True if a frame was refused since the start."""
        return bool(self._seen)

    def note(
        self,
        frame: str,
        verdict: FrameVerdict | None,
        data: bytes,
        codec: MessageCodec | None = None,
    ) -> None:
        """Remember a frame that failed a check, or of an id that nothing is taken from.

        Args:
            frame: Its message or id.
            verdict: The check, None for an id that nothing is taken from.
            data: Its bytes.
            codec: Codec of its message, None for such an id.
        """
        if verdict is None and frame not in self._seen and len(self._seen) >= _KINDS_HELD:
            return
        refusal = self._seen.setdefault(frame, {}).setdefault(verdict, _Refusal())
        refusal.count += 1
        refusal.in_a_row += 1
        refusal.data, refusal.codec = data, codec

    def accept(self, message: str) -> None:
        """Note a good frame of a message."""
        for refusal in self._seen.get(message, {}).values():
            refusal.in_a_row = 0

    def explain(self, message: str) -> str | None:
        """Return why a message has no good frame, None when none was refused since the last one."""
        found = self._seen.get(message, {})
        verdict = max(found, key=lambda one: found[one].in_a_row, default=None)
        if verdict is None or not found[verdict].in_a_row:
            return None
        count, remedy = found[verdict].in_a_row, _remedy(verdict, found[verdict])
        return f"its frames come and are refused ({verdict}, {count} in a row): {remedy}"

    def lines(self) -> Iterator[str]:
        """Every kind of refused frame, one line each."""
        for frame, found in self._seen.items():
            for verdict, refusal in found.items():
                shown = f"{refusal.count} x, last [{refusal.data.hex(' ')}]"
                if verdict is None:
                    why = f"no entry of [signals] is taken from this id, {shown}"
                else:
                    why = f"{verdict} {shown}: {_remedy(verdict, refusal)}"
                yield f"refused {frame}: {why}"


def _remedy(verdict: FrameVerdict, refusal: _Refusal) -> str:
    codec, data = refusal.codec, refusal.data
    needed = codec.required(data) if codec and verdict is FrameVerdict.WRONG_LENGTH else 0
    outside = codec.outside(data) if codec and verdict is FrameVerdict.OUT_OF_RANGE else ""
    return _REMEDIES[verdict].format(len(data), needed, outside or "its alive counter")
