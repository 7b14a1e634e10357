"""Devices on CAN and CANopen whose descriptions come with the package, against fakes."""

from __future__ import annotations

import math
import struct

import pytest

from adaptdrive.app.ports import build_port
from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.sensors import derived_value
from tests.unit.described.can_node import CanNode
from tests.unit.described.described import DEVICES, described, running
from tests.unit.devices.canopen import peer as canopen_peer
from tests.unit.devices.canopen.documents import bus_of
from tests.unit.devices.canopen.peer import ENABLED, NODE, Peer

VIRTUAL = {"interface": "virtual"}


def command(value: float) -> Command:
    return Command(current_scale_S=0.0, boost_reference_V=value, bridge=True)


async def test_the_cascadia_pm() -> None:
    node = CanNode(
        "cascadia",
        {
            165: struct.pack("<HhhH", 0, 955, 0, 0),
            166: struct.pack("<hhhh", 0, 0, 0, 250),
            167: struct.pack("<hhhh", 3600, 0, 0, 0),
            170: bytes((0, 0, 4, 0, 0, 0, 0x01, 0)),
            171: struct.pack("<4H", 0, 0, 0, 0),
            172: struct.pack("<hhI", 500, 482, 0),
        },
    )
    configuration = described("cascadia-pm", channel="cascadia", **VIRTUAL)
    async with node.served(), running(configuration) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(48.2)
        assert reading.output == pytest.approx(955 * math.pi / 30)
        assert reading.bridge
        (power,) = configuration.derived.values()
        assert derived_value(power, reading.other) == pytest.approx(360.0 * 25.0)
        run = bytes((0x22, 0xFD, 0, 0, 1, 1, 0, 0))  # -73.4 Nm, forward, enabled
        await bench.commands(command(-73.4), lambda: node.heard.get(192) == run)
        rest = bytes((0, 0, 0, 0, 1, 0, 0, 0))
        await bench.commands(SAFE_COMMAND, lambda: node.heard[192] == rest)
        node.sends[171] = struct.pack("<4H", 0, 0, 1 << 11, 0)
        await bench.commands(SAFE_COMMAND, lambda: bench.ear.readings[-1].fault)
        assert bench.ear.readings[-1].fault_name == "INV_Run_Fault_Lo bit 11 command_lost"


async def test_the_vesc() -> None:
    node = CanNode(
        "vesc",
        {
            0x1001: struct.pack(">hhhh", 253, 301, 105, 0),
            0x1B01: struct.pack(">ihH", 0, 484, 0),
            0x0901: struct.pack(">ihh", 7000, 123, 450),
        },
    )
    configuration = described("vesc", channel="vesc", **VIRTUAL)
    async with node.served(), running(configuration) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(12.3)
        assert reading.output == pytest.approx(1000 * math.pi / 30)
        (power,) = configuration.derived.values()
        assert derived_value(power, reading.other) == pytest.approx(48.4 * 10.5)
        asked = struct.pack(">i", 18250)
        await bench.commands(command(18.25), lambda: node.heard.get(0x0101) == asked)
        await bench.commands(SAFE_COMMAND, lambda: node.heard[0x0101] == bytes(4))


async def test_the_odrive() -> None:
    node = CanNode(
        "odrive",
        {
            33: struct.pack("<IBBBB", 0, 8, 0, 0, 0),
            41: struct.pack("<ff", 0.0, 10.0),
            55: struct.pack("<ff", 48.0, 0.5),
            60: struct.pack("<ff", 0.5, 0.482),
        },
    )
    configuration = described("odrive-s1", channel="odrive", **VIRTUAL)
    async with node.served(), running(configuration) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(0.482)
        assert reading.output == pytest.approx(20.0 * math.pi)
        assert reading.bridge
        await bench.commands(
            command(-1.5),
            lambda: (
                node.heard.get(46) == struct.pack("<f", -1.5)
                and node.heard.get(39) == struct.pack("<I", 8)
            ),
        )
        assert node.order[0] == 43  # torque control and passthrough, before any command
        assert node.heard[43] == struct.pack("<II", 1, 1)
        await bench.commands(SAFE_COMMAND, lambda: node.heard[39] == struct.pack("<I", 1))
        assert node.heard[46] == bytes(4)
        assert node.order.count(43) == 2  # as the bus was opened, and before it was switched on
        node.sends[33] = struct.pack("<IBBBB", 0x800, 1, 0, 0, 0)
        await bench.commands(SAFE_COMMAND, lambda: bench.ear.readings[-1].fault)
        assert bench.ear.readings[-1].fault_name == "Axis_Error 2048 (bit 11)"


async def test_the_elcon_charger() -> None:
    status, control = 0x18FF50E5, 0x1806E5F4
    node = CanNode("elcon", {status: bytes((0x03, 0x0B, 0x00, 0x60, 0x10, 0, 0, 0))})
    configuration = described("elcon-tc", channel="elcon", **VIRTUAL)
    async with node.served(), running(configuration) as bench:
        reading = await bench.reading()
        assert reading.boost_voltage_V == pytest.approx(77.9)
        assert reading.output == pytest.approx(9.6)
        assert reading.fault == 0  # bit 4 is its time-out, which the first message ends
        charge = bytes((0x03, 0xD4, 0x00, 0xC8, 0x00, 0, 0, 0))  # 98 V, 20 A
        await bench.commands(command(98.0), lambda: node.heard.get(control) == charge)
        stop = bytes((0x00, 0x00, 0x00, 0xC8, 0x01, 0, 0, 0))
        await bench.commands(SAFE_COMMAND, lambda: node.heard[control] == stop)
        node.sends[status] = bytes((0x03, 0x0B, 0x00, 0x60, 0x0A, 0, 0, 0))
        await bench.commands(SAFE_COMMAND, lambda: bench.ear.readings[-1].fault)
        name = bench.ear.readings[-1].fault_name
        assert name == "Flags bit 1 overtemperature, bit 3 no battery"


async def test_the_brusa_nlg5() -> None:
    actual = struct.pack(">HHHh", 640, 2300, 3500, 520)  # 6.4 A and 230 V in, 350 V and 5.2 A out
    node = CanNode("nlg5", {1553: actual, 1552: bytes(4)})
    async with node.served(), running(described("brusa-nlg5", channel="nlg5", **VIRTUAL)) as bench:
        reading = await bench.reading()
        assert (reading.boost_voltage_V, reading.line_voltage_V) == (350.0, 230.0)
        assert reading.output == pytest.approx(5.2)
        assert reading.load_power_W == pytest.approx(1820.0)
        charge = bytes((0x80, 0x00, 0xA0, 0x0D, 0xAC, 0x00, 0x78))  # 16 A, 350 V, 12 A
        await bench.commands(command(350.0), lambda: node.heard.get(1560) == charge)
        stop = bytes((0x00, 0x00, 0xA0, 0x00, 0x00, 0x00, 0x78))
        await bench.commands(SAFE_COMMAND, lambda: node.heard[1560] == stop)
        node.sends[1552] = bytes((0x40, 0, 0, 0))
        await bench.commands(SAFE_COMMAND, lambda: bench.ear.readings[-1].fault)


def test_no_value_of_the_brusa_nlg5_is_older_than_the_limit() -> None:
    configuration = described("brusa-nlg5")
    port = build_port(configuration, float, DEVICES / "brusa-nlg5.toml")
    assert isinstance(port, can_port.Port)
    sources = [source for status in port._mapping.statuses for source in status.sources]
    slack_s = {source.quantity: source.slack_s for source in sources}
    assert slack_s["output"] == pytest.approx(0.0)  # 2.5 cycles of 100 ms
    assert slack_s["fault"] == pytest.approx(0.0)  # no cycle time is known: those of the clock


class Servo(Peer):
    """An EPOS4: a torque of 16 bits follows the controlword."""

    def __init__(self, config: CanOpenBus) -> None:
        super().__init__(config, DEVICES / "maxon-epos4.eds")
        self.torques: list[int] = []

    def _receive(self, can_id: int, data: bytearray, stamp: float) -> None:
        word, torque = struct.unpack("<Hh", data)
        self.torques.append(torque)
        super()._receive(can_id, bytearray(struct.pack("<Hf", word, 0.0)), stamp)


async def test_the_maxon_epos4(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {"0x6077": 250, "0x606C": 955, "0x603F": 0, "0x2200.1": 480}
    monkeypatch.setattr(canopen_peer, "MEASURED", shown)
    configuration = described("maxon-epos4", channel="epos4", node_id=NODE, **VIRTUAL)
    servo = Servo(bus_of(configuration))
    try:
        servo.boot()
        async with running(configuration) as bench:
            reading = await bench.reading()
            assert servo.number(0x6060) == 10  # cyclic synchronous torque
            assert reading.boost_voltage_V == 250.0
            assert reading.output == pytest.approx(955 * math.pi / 30)
            assert reading.other["supply_voltage"] == pytest.approx(48.0)
            await bench.commands(SAFE_COMMAND, lambda: bool(servo.words))
            await bench.commands(
                command(-320.0), lambda: servo.statusword == ENABLED and servo.torques[-1] == -320
            )
            await bench.commands(SAFE_COMMAND, lambda: servo.words[-1] == 0)
            shown["0x603F"] = 0x2310
            await bench.commands(SAFE_COMMAND, lambda: bench.ear.readings[-1].fault == 0x2310)
    finally:
        servo.close()
