"""Frames of the log: records with their number, times, kind and checksum, in a file.

A frame is a mark of four bytes, the length of the rest and its CRC-32 (little-endian, four bytes
each), and the rest: number (eight bytes), monotonic and wall time (eight bytes each, in seconds),
kind (one byte) and payload. A reader that finds a frame damaged looks for the next mark whose frame
is sound, and reports what it has passed over.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

_MARK = b"aDl\x01"
_OUTER = struct.Struct("<4sII")
_INNER = struct.Struct("<QddB")
LARGEST_BYTES = 1 << 26
"""Longest rest of a frame: several times that of any record."""


class Kind(IntEnum):
    """Kind of a record."""

    BEGIN = 1
    """First of a segment: the session that it belongs to, and what earlier segments left."""
    TICKS = 2
    SLOW = 3
    SENSORS = 4
    EVENT = 5
    COMMAND = 6
    REPLY = 7
    """Reply to a command, for a repetition of it."""
    SENT = 8
    """The broker has the oldest event that it did not have."""
    LEARNT = 9
    """Estimates for the next run."""
    DROPPED = 10
    """Rows of tables that could not be kept so far."""
    END = 11
    """Orderly end of a session."""


ROW_KINDS = frozenset({Kind.TICKS, Kind.SLOW, Kind.SENSORS})
"""Kinds of which payloads are compressed, and of which the oldest may be dropped."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record.

    Attributes:
        number: Running number in the log, 0 before it is written.
        monotonic_s: When it was handed over.
        wall_s: When, by the wall clock, in seconds since 1970.
        kind: Its kind.
        payload: Its contents.
        rows: Rows of tables in it, known before it is written.
    """

    number: int
    monotonic_s: float
    wall_s: float
    kind: Kind
    payload: bytes
    rows: int = 0


@dataclass(frozen=True, slots=True)
class Loss:
    """Bytes of a segment that hold no sound frame.

    Attributes:
        begin: First of them.
        end: First byte after them.
    """

    begin: int
    end: int

    def __str__(self) -> str:
        return f"bytes {self.begin} to {self.end} cannot be read"


def framed(record: Record) -> bytes:
    """Return a record as it is in a segment."""
    inner = _INNER.pack(record.number, record.monotonic_s, record.wall_s, record.kind)
    checksum = zlib.crc32(record.payload, zlib.crc32(inner))
    return _OUTER.pack(_MARK, len(inner) + len(record.payload), checksum) + inner + record.payload


def read_frames(content: bytes) -> Iterator[Record | Loss]:
    """Yield the records of a segment, and each part of it that holds none.

    Args:
        content: The segment, which may break off anywhere.
    """
    place = 0
    while place < len(content):
        record, end = _frame(content, place)
        if record is None:
            end = _next_sound(content, place + 1)
            yield Loss(place, end)
        else:
            yield record
        place = end


def _frame(content: bytes, place: int) -> tuple[Record | None, int]:
    """Return the frame at a place and its end; None where there is no sound one."""
    begin = place + _OUTER.size
    if begin + _INNER.size > len(content):
        return None, place
    mark, length, checksum = _OUTER.unpack_from(content, place)
    end = begin + length
    if mark != _MARK or not _INNER.size <= length <= LARGEST_BYTES or end > len(content):
        return None, place
    if zlib.crc32(memoryview(content)[begin:end]) != checksum:
        return None, place
    number, monotonic_s, wall_s, kind = _INNER.unpack_from(content, begin)
    try:
        kind = Kind(kind)
    except ValueError:  # of another version
        return None, place
    return Record(number, monotonic_s, wall_s, kind, content[begin + _INNER.size : end]), end


def _next_sound(content: bytes, place: int) -> int:
    """Return where the next sound frame begins, the end of the content where there is none."""
    while (place := content.find(_MARK, place)) >= 0:
        if _frame(content, place)[0] is not None:
            return place
        place += 1
    return len(content)
