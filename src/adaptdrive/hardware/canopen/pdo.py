"""Process data objects: packing entries into frames, and the codec of each frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from canopen.objectdictionary.datatypes import SIGNED_TYPES
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from adaptdrive.hardware.canopen.dictionary import Entry
from adaptdrive.hardware.link.codec import MessageCodec

_LARGEST_BITS = 64
"""Bits of a classic CAN frame."""

_LARGEST_ENTRIES = 8
"""Mapped objects of one PDO: at least a byte each."""


@dataclass(frozen=True, slots=True)
class Channel:
    """The records that describe a PDO of the drive.

    Attributes:
        number: 1 for the first of its direction.
        cob_id: Frame id that the predefined connection set gives it.
        communication: Index of its communication parameters.
        mapping: Index of its mapping.
    """

    number: int
    cob_id: int
    communication: int
    mapping: int


@dataclass(frozen=True, slots=True)
class Pdo:
    """One process data object.

    Attributes:
        name: Such as `TPDO1`.
        channel: Where the drive keeps its description.
        entries: What travels in it, in this order.
    """

    name: str
    channel: Channel
    entries: tuple[Entry, ...]


def transmit_channel(number: int, node_id: int) -> Channel:
    """Return the PDO channel from the drive."""
    offset = number - 1
    return Channel(number, 0x180 + 0x100 * offset + node_id, 0x1800 + offset, 0x1A00 + offset)


def receive_channel(number: int, node_id: int) -> Channel:
    """Return the PDO channel to the drive."""
    offset = number - 1
    return Channel(number, 0x200 + 0x100 * offset + node_id, 0x1400 + offset, 0x1600 + offset)


def pack(name: str, channels: Sequence[Channel], entries: Iterable[Entry]) -> list[Pdo] | None:
    """Put entries into as few PDOs as need be, each into the first one with room.

    Args:
        name: `TPDO` or `RPDO`.
        channels: What the drive has.
        entries: What must travel.

    Returns:
        The PDOs in use, None when there is no room for everything.
    """
    bins: list[list[Entry]] = [[] for _ in channels]
    for entry in entries:
        chosen = next((one for one in bins if _has_room(one, entry)), None)
        if chosen is None:
            return None
        chosen.append(entry)
    return [
        Pdo(f"{name}{channel.number}", channel, tuple(found))
        for channel, found in zip(channels, bins, strict=True)
        if found
    ]


def codec(pdo: Pdo) -> MessageCodec:
    """The codec of a PDO; its signals are raw values, named by the labels of their entries."""
    signals, start = [], 0
    for entry in pdo.entries:
        signals.append(_signal(entry, start))
        start += entry.bits
    return MessageCodec(Message(pdo.channel.cob_id, pdo.name, (start + 7) // 8, signals))


def _has_room(entries: Sequence[Entry], entry: Entry) -> bool:
    bits = sum(one.bits for one in entries)
    return len(entries) < _LARGEST_ENTRIES and bits + entry.bits <= _LARGEST_BITS


def _signal(entry: Entry, start: int) -> Signal:
    return Signal(
        entry.label,
        start,
        entry.bits,
        is_signed=entry.variable.data_type in SIGNED_TYPES,
        conversion=BaseConversion.factory(is_float=not entry.coding.integer),
        minimum=entry.coding.low,
        maximum=entry.coding.high,
    )
