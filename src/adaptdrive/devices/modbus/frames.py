"""Requests and replies of Modbus as bytes, on TCP and on a serial line."""

import struct
from collections.abc import Sequence

from pymodbus.framer import FramerRTU

from adaptdrive.config.polled import RtuLink, TcpLink
from adaptdrive.devices.polled.registers import Exchange
from adaptdrive.safety.trips import TripKind

_HEADER = struct.Struct(">HHHB")
"""Head of a packet on TCP: transaction, protocol, length of all that follows it, device."""

_UNNUMBERED = 6
"""Bytes of a packet on TCP that its length does not count."""

_READ = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
_WRITE_COIL, _WRITE_REGISTER, _WRITE = 5, 6, 16
_READ_WRITE = 23
_READS = frozenset({*_READ.values(), _READ_WRITE})
_WRITES = frozenset({_WRITE_COIL, _WRITE_REGISTER, 15, _WRITE})
_ERROR = 0x80
"""Bit of the function code of an exception reply."""


_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledged, not done yet",
    6: "busy",
    10: "gateway without a path",
    11: "gateway: no reply of the device",
}
"""Codes by which a device says why it does not do what it was asked for (Modbus, 7)."""

_NO_FUNCTION = 1
_OF_GATEWAYS = frozenset({10, 11})
"""Codes of a gateway that does not reach the device."""

_UNMAPPED = frozenset({2, 3})
"""Codes by which a device refuses a read because some of its addresses hold nothing."""


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


def request(exchange: Exchange, words: Sequence[int]) -> bytes:
    """Return a request, without what frames it.

    Args:
        exchange: What is asked for.
        words: The registers that are written.
    """
    read, write, message = exchange.read, exchange.write, bytes((function_of(exchange),))
    if read is not None:
        message += struct.pack(">HH", read.address, read.count)
    if write is None:
        return message
    if write.single:
        word = 0xFF00 * bool(words[0]) if write.table == "coil" else words[0]
        return message + struct.pack(">HH", write.address, word)
    head = struct.pack(">HHB", write.address, write.count, 2 * write.count)
    return message + head + struct.pack(f">{write.count}H", *words)


def exception_code(reply: bytes) -> int | None:
    """Return the code of an exception reply, 0 where it has none; None for another reply."""
    return (*reply[1:2], 0)[0] if reply[0] & _ERROR else None


def answer(reply: bytes, asked: bytes, exchange: Exchange) -> list[int] | None:
    """Return the registers of a reply, None for one to another request.

    The reply to a write repeats its address and, of several registers, their count.

    Args:
        reply: What came, without what frames it.
        asked: The request.
        exchange: What was asked for.
    """
    if reply[0] != asked[0]:
        return None
    read = exchange.read
    if read is None:
        repeated = 3 if asked[0] in {_WRITE_COIL, _WRITE_REGISTER} else 5
        return [] if reply[1:repeated] == asked[1:repeated] else None
    data = reply[2:]
    if len(reply) != exchange.reply_bytes or len(data) != reply[1]:
        return None
    if read.table in {"coil", "discrete"}:
        return [data[number // 8] >> number % 8 & 1 for number in range(read.count)]
    return list(struct.unpack(f">{read.count}H", data))


def explain_exception(code: int, exchange: Exchange) -> tuple[TripKind, str]:
    """Return the kind of trip of an exception reply, and the reply in words.

    Args:
        code: Exception code of the device.
        exchange: What was asked for.
    """
    name = _EXCEPTIONS.get(code, "unknown")
    refused = f"exception reply {code} to function {function_of(exchange)} ({name}), {exchange}"
    kind, hint = _remedy(code, exchange)
    return kind, f"{refused}{hint}"


def _remedy(code: int, exchange: Exchange) -> tuple[TripKind, str]:
    """Return the kind of trip, and the key of `[bus]` that may avoid it, empty for none."""
    read, write = exchange.read, exchange.write
    if code in _UNMAPPED and read is not None and read.gap:
        across = f"; it runs across {read.gap} addresses that no entry names"
        return TripKind.REGISTERS_MISSING, f"{across}: max_gap = {read.gap - 1} reads without them"
    if code in _OF_GATEWAYS:
        return TripKind.GATEWAY, ""
    if code != _NO_FUNCTION or write is None or write.table != "holding":
        return TripKind.POLL_REFUSED if write is None else TripKind.COMMAND_REFUSED, ""
    if read is not None:
        own = "; bus.write = 'multiple' writes in a request of its own"
        return TripKind.WRITE_FUNCTION, own
    other = ("multiple", _WRITE) if write.single else ("single", _WRITE_REGISTER)
    text = f"; bus.write = {other[0]!r} writes by function {other[1]}"
    return TripKind.WRITE_FUNCTION, text


class TcpFrames:
    """Packets on TCP: the transaction id shows to which request a reply belongs.

    Attributes:
        foreign: Packets with other transaction ids that came since the last request.
    """

    def __init__(self) -> None:
        self._transaction = self._device = self.foreign = 0

    def framed(self, message: bytes, device: int) -> bytes:
        """Return the packet of a request."""
        self._transaction, self._device = self._transaction % 0xFFFF + 1, device
        return _HEADER.pack(self._transaction, 0, len(message) + 1, device) + message

    def reply(self, received: bytes) -> bytes | None:
        """Return the reply among what came since the request, None while there is none."""
        self.foreign = 0
        while len(received) > _HEADER.size:
            transaction, protocol, length, device = _HEADER.unpack_from(received)
            packet, received = received[: length + _UNNUMBERED], received[length + _UNNUMBERED :]
            whole = len(packet) == length + _UNNUMBERED and _is_known(packet[_HEADER.size :])
            if transaction != self._transaction:
                self.foreign += 1
            elif whole and protocol == 0 and self._device in {0, device}:
                return packet[_HEADER.size :]
        return None

    def explain(self, received: bytes) -> str:
        """Return why what came is no reply."""
        head = received[: _HEADER.size].ljust(_HEADER.size, b"\0")
        came, protocol, length, replied = _HEADER.unpack(head)
        if came != self._transaction:
            return "one to another transaction came"
        if replied != self._device:
            return f"device {replied} replied, asked was device {self._device}"
        if protocol != 0:
            return f"one of protocol {protocol} came, that of Modbus is 0"
        return f"{len(received) - _UNNUMBERED} bytes of one came whose header says {length}"


class SerialFrames:
    """Frames on a serial line, one at a time; an adapter of two wires receives what it sends.

    The request for one register from 0x300 to 0x3FF is, byte for byte, also a reply of three bytes.
    The reply to a single write (functions 5 and 6) repeats its request: what came for another
    request shows whether the line repeats it, too. Until then one copy of a single write is its
    echo, and acknowledges nothing.
    """

    foreign = 0

    def __init__(self) -> None:
        self._sent = b""
        self._echoes: bool | None = None

    def framed(self, message: bytes, device: int) -> bytes:
        """Return the frame of a request."""
        frame = bytes((device,)) + message
        self._sent = frame + _checksum(frame)
        return self._sent

    def reply(self, received: bytes) -> bytes | None:
        """Return the reply among what came since the request, None while there is none."""
        single = self._sent[1] in {_WRITE_COIL, _WRITE_REGISTER}
        echoed = received.startswith(self._sent) and not (single and self._echoes is False)
        reply = self._unframed(received[len(self._sent) :] if echoed else received)
        if reply is not None and not single:
            self._echoes = echoed
        return reply

    def _unframed(self, received: bytes) -> bytes | None:
        """Return the message of a whole frame of the device that was asked, None without one."""
        size = _size(received[1:])
        body, checksum = received[: size - 2], received[size - 2 : size]
        ours = self._sent[0] in {0, *received[:1]}
        return body[1:] if size and ours and checksum == _checksum(body) else None

    @staticmethod
    def explain(received: bytes) -> str:
        """Return what came in place of a reply."""
        more = "…" if len(received) > _SHOWN_BYTES else ""
        return f"bytes that are no reply: {received[:_SHOWN_BYTES].hex(' ')}{more}"


_SHOWN_BYTES = 16
"""Bytes of what came in place of a reply that a message shows."""


def _is_known(message: bytes) -> bool:
    return bool(message) and message[0] & ~_ERROR in _READS | _WRITES


def _size(message: bytes) -> int:
    """Return the bytes of a frame on a serial line, 0 while they are not known."""
    if len(message) < 2 or not _is_known(message):
        return 0
    if message[0] & _ERROR:
        return 5
    return 5 + message[1] if message[0] in _READS else 8


def _checksum(frame: bytes) -> bytes:
    return FramerRTU.compute_CRC(frame).to_bytes(2, "big")


def are_alike(config: TcpLink | RtuLink, exchanges: Sequence[Exchange]) -> bool:
    """Return whether a reply, repeated on a serial line, may pass for that to another exchange.

    Args:
        config: Which link.
        exchanges: What is asked for, in any order.
    """
    forms = [(function_of(one), one.device_id, one.reply_bytes) for one in exchanges]
    return not config.numbered and len({*forms}) < len(forms)
