"""A healthy drive on a line that loses or repeats replies, judged by counts in virtual time."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.config.sensors import ModbusRtuSensors
from adaptdrive.control.signals import Command
from adaptdrive.hardware.modbus.port import ModbusPort
from adaptdrive.hardware.modbus.sensors import build_modbus_sensors
from adaptdrive.hardware.port import Reading
from tests.config.modbus_documents import parse
from tests.hardware.bench import Ear
from tests.hardware.modbus.bench import FUNCTION_23, MAP, Peer, framed, reported, serial
from tests.hardware.modbus.test_sensors import COMMON as SENSORS
from tests.hardware.modbus.virtual import Follower, VirtualDrive, VirtualLoop, is_serial, use_memory

POLLS = 6000
LOST_SHARE = 0.05
STARVED = 8
"""Reads without a command in between: five replies in a row are lost before, or it is held back."""

REPEATED = 20
"""The request whose reply is repeated, or one soon after."""

APART_s = 0.0015
"""Time after a reply at which its copy comes, before the next request."""


class Line:
    """A port in virtual time that commands its drive on with each reading.

    Attributes:
        drive: The drive, which reports its bridge on.
        ear: What was heard.
        complaints: Every complaint of the port.
    """

    def __init__(self, kind: str, changes: dict[str, str | None], device: Path) -> None:
        link = serial(device) if kind == "rtu" else {}
        peer = Peer(10 if changes else 0)
        peer.state = 1
        self.drive = VirtualDrive(peer)
        self._loop = VirtualLoop(self.drive)
        document = parse(**{**MAP, **link, **reported(changes)})
        tested = build_port(document, self._loop.time, "losses.toml")
        assert isinstance(tested, ModbusPort)
        self.port = tested
        self.ear: Ear = Follower(self._decide)
        self.complaints: set[str | None] = set()

    def _decide(self, reading: Reading) -> None:
        self.complaints.add(self.port.complaint)
        assert reading.bridge
        wanted_V = 250.0 + len(self.ear.readings) % 100
        self.port.send(Command(current_scale_S=0.0, boost_reference_V=wanted_V, bridge=True))

    def run(self, enough: Callable[[], bool]) -> None:
        """Poll until there is enough."""
        self._loop.serve(self.port.run(self.ear, lambda: None), enough)


@pytest.fixture(autouse=True)
def in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    use_memory(monkeypatch)


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_five_lost_replies_in_a_hundred_neither_trip_nor_starve(
    kind: str, changes: dict[str, str | None], tmp_path: Path
) -> None:
    line, draw = Line(kind, changes, tmp_path / "line"), random.Random(5)
    line.drive.copies = lambda _: () if draw.random() < LOST_SHARE else (0.0,)
    line.run(lambda: len(line.ear.readings) > POLLS)
    assert line.port.statistics.timeouts > 0.5 * LOST_SHARE * POLLS
    assert line.complaints == {None}
    assert line.port.statistics.reconnects == 0
    assert line.drive.longest < STARVED
    assert len({words[0] for _, words in line.drive.peer.writes}) > 99


@pytest.mark.parametrize("changes", [{}, FUNCTION_23], ids=["apart", "function-23"])
@pytest.mark.parametrize("size", [1, 5, 8, 99])
def test_an_adapter_that_hears_its_request_in_pieces_costs_no_reply(
    size: int, changes: dict[str, str | None], tmp_path: Path
) -> None:
    """The event loop wakes up at a byte, and reads what has come until then."""
    line = Line("rtu", changes, tmp_path / "line")
    line.drive.echo = lambda sent: [sent[at : at + size] for at in range(0, len(sent), size)]
    line.run(lambda: len(line.drive.peer.requests) > POLLS // 10)
    counts = line.port.statistics
    assert (counts.timeouts, counts.wrong_checksum, counts.foreign, counts.send_drops) == (0,) * 4
    assert len(line.drive.peer.writes) >= len(line.ear.readings) > POLLS // 40


def test_a_drive_seen_before_a_line_that_repeats_fell_silent_is_read_again(
    tmp_path: Path,
) -> None:
    """The command waits for the silence, and the drive's own time-out may end meanwhile."""
    line = Line("rtu", {}, tmp_path / "line")
    requests, spoiled = line.drive.peer.requests, list[int]()

    def repeated(_: bytes) -> tuple[float, ...]:
        if spoiled or len(requests) < REPEATED or requests[-1][0] == 16:
            return (0.0,)
        spoiled.append(len(requests))
        return (0.0, APART_s)

    line.drive.copies = repeated
    line.run(lambda: bool(spoiled) and len(requests) > spoiled[0] + 3)
    functions = [request[0] for request in requests[spoiled[0] :]]
    assert functions[0] in {3, 4}
    assert functions[1] == 16


class SensorEar:
    """Counts the values of two registers that are those of the other one."""

    def __init__(self) -> None:
        self.mixed_up = 0

    def on_values(self, values: Mapping[str, float], _: float) -> None:
        own = {"number": values.get("number") != 30012, "voltage": values.get("voltage") == 300.12}
        self.mixed_up += not all(own[name] for name in own.keys() & values.keys())

    def on_bus(self, up: bool, detail: str) -> None:
        """Take note of nothing."""


def test_a_sensor_line_that_repeats_each_reply_mixes_up_one_value() -> None:
    """The copy comes when the next cycle has begun: it passed for the reply to its first read."""
    peer = Peer()
    drive = VirtualDrive(peer)
    drive.copies = lambda _: (0.002, 0.022)
    loop, ear = VirtualLoop(drive), SensorEar()
    line = {"type": "modbus-rtu", "device": "line", "baud": 115200, "parity": "none"}
    cycle = {"cycle_s": 0.05, "timeout_s": 0.024, "max_gap": 0, "max_block": 2}
    config = ModbusRtuSensors.model_validate(SENSORS | line | cycle)
    tested = build_modbus_sensors(config, "sensor_bus.0", loop.time)

    end_s = loop.time() + 60.0
    loop.serve(tested.run(ear), lambda: loop.time() >= end_s)
    assert tested.statistics.foreign > 100
    assert ear.mixed_up <= 1


def test_a_request_on_tcp_that_ends_with_its_own_checksum_is_not_taken_for_a_serial_one() -> None:
    request = bytes.fromhex("01550000000b0110000000020461a50001")
    assert framed(request[:-2]) == request
    assert not is_serial(request)
    assert is_serial(framed(bytes.fromhex("010400000002")))
