"""Decoders of what comes by a wire: frames, PDOs, SDO and Modbus replies, registers."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from canopen import Network
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from cantools.database.can.message import Message

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus, CanOpenBus
from adaptdrive.config.polled import ModbusTcp, Register
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.database import read_dbc
from adaptdrive.devices.can.integrity import FrameVerdict
from adaptdrive.devices.can.layout import compile_field
from adaptdrive.devices.canopen.mapping import map_drive
from adaptdrive.devices.canopen.profile import parse_emergency
from adaptdrive.devices.canopen.sdo import Server
from adaptdrive.devices.field import Field
from adaptdrive.devices.polled.registers import decode, register_field
from adaptdrive.util.errors import BusError
from tools.fuzz.random_messages import random_message
from tools.fuzz.target import EXAMPLES, Target

_ADDRESS = (0x1018, 1)
_MESSAGES = 256
_NOT_WHOLE = frozenset({FrameVerdict.WRONG_LENGTH, FrameVerdict.WRONG_CHECKSUM})


@functools.cache
def _codecs() -> tuple[MessageCodec, ...]:
    names = ("adaptdrive.dbc", "inverter.dbc", "bath.dbc", "battery.dbc")
    bases = [read_dbc(EXAMPLES / name)[0] for name in names]
    known = [message for base in bases for message in base.messages]
    plain = [MessageCodec(message) for message in known]
    part = [MessageCodec(one, fields=_last(one)) for one in known]
    return (*plain, *part, *_protected("motor-inverter.toml"), *_protected("battery.toml"))


def _last(message: Message) -> dict[str, Field]:
    """How the last signal of a message is coded."""
    field = compile_field(message.signals[-1])
    return {field.name: field}


def _protected(name: str) -> list[MessageCodec]:
    """The messages of an example whose frames have a counter or a checksum."""
    bus = load_configuration(EXAMPLES / name).bus
    assert isinstance(bus, CanBus)
    known = read_dbc(bus.database[0])[0].get_message_by_name
    return [MessageCodec(known(one), integrity) for one, integrity in bus.integrity.items()]


def frame(data: bytes) -> object:
    """Read a CAN frame of an example; the first byte chooses its message."""
    codecs = _codecs()
    return _judged(codecs[data[0] % len(codecs)], data[1:65]) if data else None


@functools.cache
def _random_codec(seed: int) -> MessageCodec:
    return MessageCodec(random_message(seed))


def random_frame(data: bytes) -> object:
    """Read a CAN frame by a DBC drawn at random; the first byte chooses it."""
    return _judged(_random_codec(data[0] % _MESSAGES), data[1:65]) if data else None


def _judged(codec: MessageCodec, data: bytes) -> object:
    """Decode a frame, and hold that one which is not whole gives nothing and changes nothing."""
    last = codec._alive._last
    decoded = codec.decode(data)
    if decoded[0] in _NOT_WHOLE:
        assert not decoded[1], decoded[0]
        assert codec._alive._last == last, decoded[0]
    return decoded


@functools.cache
def _pdos() -> tuple[MessageCodec, ...]:
    configuration = load_configuration(EXAMPLES / "motor-cia402.toml")
    assert isinstance(configuration.bus, CanOpenBus)
    mapping = map_drive(configuration.bus, configuration.signals, "motor-cia402.toml")
    return tuple(one.codec for one in mapping.statuses)


def pdo(data: bytes) -> object:
    """Read a PDO, and the same bytes as an emergency."""
    codecs = _pdos()
    found = _judged(codecs[data[0] % len(codecs)], data[1:9]) if data else None
    return found, str(parse_emergency(data[:8]))


class _Answers(Network):
    """A bus on which each request is answered by the next eight bytes, as long as there are any."""

    def __init__(self, data: bytes) -> None:
        super().__init__()
        self._data = data

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if not self._data:
            raise BusError("set-up", "given up")
        answer, self._data = self._data[:8], self._data[8:]
        self.notify(0x585, bytearray(answer), 0.0)


def sdo(data: bytes) -> int:
    """Read an entry, or write one, from a drive that answers anything."""
    client = SdoClient(0x605, 0x585, ObjectDictionary())
    client.RESPONSE_TIMEOUT = 0.0
    client.network = _Answers(data[1:])
    client.network.subscribe(client.tx_cobid, client.on_response)
    server = Server(client, "node 5")
    if data[:1] < b"\x55":
        return server.number(_ADDRESS)
    if data[:1] < b"\xaa":
        server.write_surely(_ADDRESS, data[1:3] or b"\0")
    server.write(_ADDRESS, bytes(12))
    return 0


@functools.cache
def _registers() -> Mapping[str, Register]:
    bus = load_configuration(EXAMPLES / "motor-modbus-tcp.toml").bus
    assert isinstance(bus, ModbusTcp)
    return bus.registers


def registers(data: bytes) -> object:
    """Read a value of a reply on Modbus; from each of the registers."""
    found: list[object] = []
    for register in _registers().values():
        words = [_word(data, i) for i in range(register.end - register.address)]
        fields = register_field("", register, "measured"), register_field("", register, "word")
        found += [decode(register, field, words) for field in fields]
    return found


def _word(data: bytes, number: int) -> int:
    return int.from_bytes(data[2 * number : 2 * number + 2], "big")


_FRAMES = (bytes(9), bytes(range(9)), b"\xff" * 9)
_SDO = (
    bytes.fromhex("00 4f18100105000000"),
    bytes.fromhex("00 4118100109000000 0031323334353637 1138390000000000"),
    bytes.fromhex("00 8018100100000206"),
    bytes.fromhex("60 6018100100000000 4b18100160180000"),
    bytes.fromhex("b0 6018100100000000 2000000000000000 3000000000000000"),
)

WIRES: dict[str, Target] = {
    "frame": Target(frame, (), _FRAMES, 8000),
    "random-dbc": Target(random_frame, (), _FRAMES, 4000),
    "pdo": Target(pdo, (), _FRAMES, 4000),
    "sdo": Target(sdo, (BusError,), _SDO, 2000),
    "registers": Target(registers, (), (bytes(4), b"\x7f\xc0\x00\x00", b"\xff" * 4), 3000),
}
