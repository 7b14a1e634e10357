"""Replies on Modbus as the link takes them: any bytes, and any function in a frame."""

from __future__ import annotations

import functools
import struct
from collections import Counter

from crccheck.crc import CrcModbus

from adaptdrive.config import load_configuration
from adaptdrive.config.polled import RtuLink, TcpLink
from adaptdrive.devices.modbus.frames import TcpFrames, request
from adaptdrive.devices.modbus.link import ModbusConnection
from adaptdrive.devices.polled.link import ExchangeError
from adaptdrive.devices.polled.registers import Block, Exchange
from tools.fuzz.target import EXAMPLES, Target

_EXCHANGE = Exchange(read=Block("input", 0, 2))
_TRANSACTION = 7


@functools.cache
def _link(name: str) -> ModbusConnection:
    config = load_configuration(EXAMPLES / name).bus
    assert isinstance(config, TcpLink | RtuLink)
    return ModbusConnection(config, Counter(), lambda: 0.0)


def tcp(data: bytes) -> object:
    """Take bytes from a TCP connection; half of them are framed as the reply to the request."""
    if data[:1] < b"\x80":
        pdu = data[1:]
        data = b"_" + struct.pack(">HHHB", _TRANSACTION, 0, len(pdu) + 1, 1) + pdu
    return _taken("motor-modbus-tcp.toml", data[1:])


def rtu(data: bytes) -> object:
    """Take bytes from a serial line; half of them have the device id and the right checksum."""
    if data[:1] < b"\x80":
        message = b"\x01" + data[1:]
        data = b"_" + message + CrcModbus.calc(message).to_bytes(2, "little")
    return _taken("motor-modbus-rtu.toml", data[1:])


def _taken(name: str, data: bytes) -> object:
    connection = _link(name)
    frames, stream, asked = connection._frames, connection._stream, request(_EXCHANGE, [])
    if isinstance(frames, TcpFrames):
        frames._transaction = _TRANSACTION - 1
    frames.framed(asked, 1)
    stream.received = b""
    reply = None
    for piece in (data[:5], data[5:]):
        if piece and reply is None:
            stream.data_received(piece)
            reply = frames.reply(stream.received)
    if reply is None:
        return frames.explain(stream.received)
    return connection._checked(reply, asked, _EXCHANGE)


def _pdus() -> tuple[bytes, ...]:
    """Each function that the specification has, with four bytes and with none."""
    some = [bytes((0, function, 4, 1, 2, 3, 4)) for function in range(1, 0x2C)]
    none = [bytes((0, function)) for function in (3, 4, 16, 23, 0x2B, 0x80, 0x84)]
    return (*some, *none, b"\x00\x2b\x0e\x01\x01\0\0\1\0\3abc", b"\xff\0\7\0\0\0\7\1\4\4abcd")


REPLIES: dict[str, Target] = {
    "modbus-tcp": Target(tcp, (ExchangeError,), _pdus(), 4000),
    "modbus-rtu": Target(rtu, (ExchangeError,), _pdus(), 4000),
}
