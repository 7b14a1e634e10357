"""Decoders of what comes from outside, each as a function of bytes.

Whatever the bytes are, a target ends with a value or with the error that its decoder documents.
Anything else is a fault, and so is an input that takes long.
"""

from __future__ import annotations

import functools
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.app.checkpoint import CheckpointError, configuration_key, read_checkpoint
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import load_configuration
from adaptdrive.config.file import parse_configuration
from adaptdrive.config.modbus import ModbusTcp, Register
from adaptdrive.control.load import Load
from adaptdrive.control.settings import Jacket
from adaptdrive.errors import ConfigurationError, RecordingError, RefusedError
from adaptdrive.hardware.dbc.database import load_database
from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.modbus.codec import decode_value
from adaptdrive.operation.commands import VERBS, Payload
from adaptdrive.recording.reader import read_session

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"


@dataclass(frozen=True, slots=True)
class Target:
    """A decoder.

    Attributes:
        decode: Takes any bytes.
        errors: What it may raise.
        corpus: Good inputs, from which mutations begin.
        quick: Inputs for a test of a few seconds.
    """

    decode: Callable[[bytes], object]
    errors: tuple[type[Exception], ...]
    corpus: tuple[bytes, ...]
    quick: int


@functools.cache
def _folder() -> Path:
    """A folder for the files that decoders read, kept until the process ends."""
    folder = tempfile.TemporaryDirectory(prefix="fuzz-")
    _KEPT.append(folder)
    return Path(folder.name)


_KEPT: list[tempfile.TemporaryDirectory[str]] = []


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


def toml(data: bytes) -> object:
    """Read a configuration."""
    return parse_configuration(data.decode("utf-8", "replace"), EXAMPLES / "fuzzed.toml")


def mqtt(data: bytes) -> object:
    """Read a command; the first byte chooses its verb."""
    payload = Payload(data[1:])
    json.dumps([payload.id, payload.value, payload.user])
    return payload.request(VERBS[data[0] % len(VERBS)] if data else "")


def dbc(data: bytes) -> object:
    """Read a DBC."""
    return load_database(_file("fuzzed.dbc", data))


@functools.cache
def _codecs() -> tuple[MessageCodec, ...]:
    files = ("adaptdrive.dbc", "inverter.dbc", "bath.dbc", "battery.dbc")
    bases = [load_database(EXAMPLES / name) for name in files]
    return tuple(MessageCodec(message) for base in bases for message in base.messages)


def frame(data: bytes) -> object:
    """Read a CAN frame; the first byte chooses its message."""
    codecs = _codecs()
    return codecs[data[0] % len(codecs)].decode(data[1:65]) if data else None


@functools.cache
def _registers() -> tuple[Register, ...]:
    bus = load_configuration(EXAMPLES / "motor-modbus-tcp.toml").bus
    assert isinstance(bus, ModbusTcp)
    return tuple(bus.registers.values())


def registers(data: bytes) -> object:
    """Read a value of a reply on Modbus; from each of the registers."""
    found: list[object] = []
    for register in _registers():
        words = [_word(data, i) for i in range(register.end - register.address)]
        found += [decode_value(register, words, measured=measured) for measured in (True, False)]
    return found


def _word(data: bytes, number: int) -> int:
    return int.from_bytes(data[2 * number : 2 * number + 2], "big")


@functools.cache
def _motor() -> tuple[str, Load, Jacket]:
    motor = load_configuration(EXAMPLES / "motor.toml")
    return configuration_key(motor), build_load(motor), controller_settings(motor).jacket


def checkpoint(data: bytes) -> object:
    """Read a checkpoint."""
    key, load, jacket = _motor()
    path = _file("motor.estimates.json", data)
    return read_checkpoint(path, key, load, jacket)


def session(data: bytes) -> object:
    """Read a session whose description is damaged."""
    folder = _folder() / "session"
    folder.mkdir(exist_ok=True)
    (folder / "session.json").write_bytes(data)
    (folder / "configuration.toml").write_text((EXAMPLES / "motor.toml").read_text())
    return read_session(folder)


def _texts(*names: str) -> tuple[bytes, ...]:
    return tuple((EXAMPLES / name).read_bytes() for name in names)


_COMMANDS = (
    b'0{"id":"a","value":3.3}',
    b'1{"id":"b","value":{"shape":"square","low":3,"high":3.2,"period_s":20}}',
    b'4{"id":"c","value":300,"hold_s":2,"user":"x","expires":"2026-01-01T00:00:00Z"}',
    b'5{"id":"d"}',
)
_CHECKPOINT = (
    b'{"key":"%s","saved":"2026-01-01T00:00:00Z","format":1,'
    b'"estimates":{"gain":0.011,"tau_motor_s":11.7,"tau_filter_s":10.0}}'
) % _motor()[0].encode()
_SESSION = (
    b'{"drive":"motor","version":"0.1.0","started":"2026-01-01T00:00:00Z","ticks_per_period":120,'
    b'"latency_ticks":2,"line_frequency_Hz":60.0,"ended":"orderly","format":1}'
)

TARGETS: dict[str, Target] = {
    "toml": Target(toml, (ConfigurationError,), _texts("motor.toml", "bath-modbus-tcp.toml"), 60),
    "mqtt": Target(mqtt, (RefusedError,), _COMMANDS, 4000),
    "dbc": Target(dbc, (ConfigurationError,), _texts("inverter.dbc", "battery.dbc"), 40),
    "frame": Target(frame, (), (bytes(9), bytes(range(9)), b"\xff" * 9), 8000),
    "registers": Target(registers, (), (bytes(4), b"\x7f\xc0\x00\x00", b"\xff" * 4), 3000),
    "checkpoint": Target(checkpoint, (CheckpointError,), (_CHECKPOINT,), 300),
    "session": Target(session, (RecordingError,), (_SESSION,), 200),
}
