"""The reply that belongs to a request, and what came where none does."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from pymodbus.pdu import ModbusPDU

from adaptdrive.config.modbus import RtuLink, TcpLink
from adaptdrive.hardware.modbus.capacity import Exchange

_HEADER = struct.Struct(">HHHB")
"""Head of a packet on TCP: transaction, protocol, length of all that follows it, device."""

_READ = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
_WRITE_COIL, _WRITE_REGISTER, _WRITE = 5, 6, 16
_READ_WRITE = 23

EXCEPTIONS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledged, not done yet",
    6: "busy",
    10: "gateway without a path",
    11: "gateway: no reply of the device",
}


def function_of(exchange: Exchange) -> int:
    """Return the function code of a request, which its reply repeats.

    Args:
        exchange: What is asked for.
    """
    if exchange.read is not None:
        return _READ[exchange.read.table] if exchange.write is None else _READ_WRITE
    if exchange.write is None or not exchange.write.single:
        return _WRITE
    return _WRITE_COIL if exchange.write.table == "coil" else _WRITE_REGISTER


def answers(reply: ModbusPDU, exchange: Exchange) -> bool:
    """Return whether a reply fits its request: to a write, it repeats the address and the count.

    Args:
        reply: What came.
        exchange: What was asked for.
    """
    if reply.function_code != function_of(exchange):
        return False
    read, written = exchange.read, exchange.write
    if read is not None and read.table in {"coil", "discrete"}:
        return len(reply.bits) == 8 * ((read.count + 7) // 8)
    if read is not None:
        return len(reply.registers) == read.count
    if written is not None and written.single:
        return reply.address == written.address
    return written is None or (reply.address, reply.count) == (written.address, written.count)


def explain_exception(code: int, exchange: Exchange) -> str:
    """Return an exception reply in words.

    Args:
        code: Exception code of the device.
        exchange: What was asked for.
    """
    asked = exchange.write if exchange.read is None else exchange.read
    name = EXCEPTIONS.get(code, "unknown")
    return f"exception reply {code} to function {function_of(exchange)} ({name}), {asked}"


def explain_other(packet: bytes, transaction: int, device: int) -> str:
    """Return why a packet on TCP is no reply to a request.

    Args:
        packet: What came.
        transaction: Transaction id of the request.
        device: Device that was asked.
    """
    came, protocol, length, replied = _HEADER.unpack(
        packet[: _HEADER.size].ljust(_HEADER.size, b"\0")
    )
    if came != transaction:
        return "one to another transaction came"
    if replied != device:
        return f"device {replied} replied, asked was device {device}"
    if protocol != 0:
        return f"one of protocol {protocol} came, that of Modbus is 0"
    return f"{len(packet) - _HEADER.size + 1} bytes of one came whose header says {length}"


def are_alike(config: TcpLink | RtuLink, exchanges: Sequence[Exchange]) -> bool:
    """Return whether a reply, repeated on a serial line, may pass for that to the next exchange.

    Args:
        config: Which link.
        exchanges: What is asked for in turn; the first one follows the last.
    """
    pairs = zip(exchanges, [*exchanges[1:], *exchanges[:1]], strict=True)
    return not config.numbered and any(_are_alike(*pair) for pair in pairs)


def _are_alike(one: Exchange, other: Exchange) -> bool:
    same = (function_of(one), one.device_id) == (function_of(other), other.device_id)
    return same and one.reply_bytes == other.reply_bytes and one.read != other.read
