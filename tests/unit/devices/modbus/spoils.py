"""What can become of a reply on its way, or of what it says."""

from __future__ import annotations

import struct

from tests.unit.devices.modbus.bench import Pieces, TIMEOUT_s, framed


def silence(_: bytes) -> Pieces:
    return []


def late(reply: bytes) -> Pieces:
    return [(1.8 * TIMEOUT_s, reply)]


def cut(reply: bytes) -> Pieces:
    return [(0.0, reply[:-3])]


def flipped(reply: bytes) -> Pieces:
    return [(0.0, reply[:4] + bytes((reply[4] ^ 1,)) + reply[5:])]


def noisy(reply: bytes) -> Pieces:
    return [(0.0, b"\x00\xff\x7e" + reply)]


def foreign_device(reply: bytes) -> Pieces:
    return [(0.0, framed(b"\x02" + reply[1:-2]))]


def other_transaction(reply: bytes) -> Pieces:
    number = struct.unpack(">H", reply[:2])[0]
    return [(0.0, struct.pack(">H", number + 7) + reply[2:])]


def no_transaction(reply: bytes) -> Pieces:
    return [(0.0, b"\0\0" + reply[2:])]


def other_protocol(reply: bytes) -> Pieces:
    return [(0.0, reply[:2] + b"\0\x01" + reply[4:])]


def exception(pdu: bytes) -> bytes:
    return bytes((pdu[0] | 0x80, 2))


def busy(pdu: bytes) -> bytes:
    return bytes((pdu[0] | 0x80, 6))


def fewer(pdu: bytes) -> bytes:
    return bytes((pdu[0], pdu[1] - 2)) + pdu[2:-2] if pdu[0] == 4 else pdu


def other_function(pdu: bytes) -> bytes:
    return b"\x03" + pdu[1:] if pdu[0] == 4 else pdu


def other_address(pdu: bytes) -> bytes:
    if pdu[0] != 16:
        return pdu
    address = struct.unpack(">H", pdu[1:3])[0]
    return pdu[:1] + struct.pack(">H", address + 1) + pdu[3:]


def nothing_written(pdu: bytes) -> bytes:
    return pdu[:3] + b"\0\0" if pdu[0] == 16 else pdu
