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


_CHANNELS = {"TPDO": (0x180, 0x1800), "RPDO": (0x200, 0x1400)}
"""Frame id and index of the first PDO from a drive, and to it (CiA 301)."""

_PRECONFIGURED = 4
"""PDOs of each direction to which CiA 301 gives identifiers."""


@dataclass(frozen=True, slots=True)
class Channel:
    """The records that describe a PDO of the drive.

    Attributes:
        name: Such as `TPDO1`.
        cob_id: Frame id that the predefined connection set gives it.
        communication: Index of its communication parameters.
        mapping: Index of its mapping.
    """

    name: str
    cob_id: int
    communication: int
    mapping: int


@dataclass(frozen=True, slots=True)
class Pdo:
    """One process data object.

    Attributes:
        channel: Where the drive keeps its description.
        entries: What travels in it, in this order.
    """

    channel: Channel
    entries: tuple[Entry, ...]


def channels_of(kind: str, node_id: int) -> list[Channel]:
    """Return the PDO channels from a drive (`TPDO`) or to it (`RPDO`)."""
    cob_id, first = _CHANNELS[kind]
    return [
        Channel(f"{kind}{n + 1}", cob_id + 0x100 * n + node_id, first + n, first + 0x200 + n)
        for n in range(_PRECONFIGURED)
    ]


def pack(channels: Sequence[Channel], entries: Iterable[Entry]) -> list[Pdo] | None:
    """Put entries into as few PDOs as need be, each into the first one with room.

    Args:
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
        Pdo(channel, tuple(found)) for channel, found in zip(channels, bins, strict=True) if found
    ]


def codec(pdo: Pdo) -> MessageCodec:
    """The codec of a PDO; its signals are raw values, named by the labels of their entries."""
    signals, start = [], 0
    for entry in pdo.entries:
        signals.append(_signal(entry, start))
        start += entry.bits
    return MessageCodec(Message(pdo.channel.cob_id, pdo.channel.name, (start + 7) // 8, signals))


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
