"""A drive that sends and takes registers behind one id each, by the layout of its manual."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import can
import pytest

from adaptdrive.config.bus import CanBus, Signals
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.assembly import CanMapping
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.safety.timing import Timing
from adaptdrive.util.errors import ConfigurationError
from tests.unit.devices.bench import Clock, Ear, running, until

SPEED, CURRENT, STATUS, ERRORS = 0x30, 0x20, 0x40, 0x8F
TORQUE, DISABLE, ASK = 0x90, 0x51, 0x3D
DBC = """VERSION ""
BU_: HOST D3
BO_ 385 TX: 6 D3
 SG_ REGISTER M : 0|8@1+ (1,0) [0|255] "" HOST
 SG_ SPEED m48 : 8|16@1- (0.5,0) [-6000|6000] "rpm" HOST
 SG_ CURRENT m32 : 8|16@1- (0.1,0) [-3000|3000] "V" HOST
 SG_ STATUS m64 : 8|32@1+ (1,0) [0|4294967295] "" HOST
 SG_ ERRORS m143 : 8|16@1+ (1,0) [0|65535] "" HOST
BO_ 513 RX: 3 HOST
 SG_ REGISTER M : 0|8@1+ (1,0) [0|255] "" D3
 SG_ TORQUE m144 : 8|16@1- (0.01,0) [-100|100] "V" D3
 SG_ DISABLE m81 : 8|16@1+ (1,0) [0|65535] "" D3
 SG_ ASKED m61M : 8|8@1+ (1,0) [0|255] "" D3
 SG_ SPEED_MS m48 : 16|8@1+ (1,0) [0|255] "ms" D3
 SG_ STATUS_MS m64 : 16|8@1+ (1,0) [0|255] "ms" D3
BO_ 514 WAKE: 1 HOST
 SG_ CALL : 0|8@1+ (1,0) [0|255] "" D3
BO_ 515 BACK: 3 HOST
 SG_ VOLTS : 0|16@1+ (0.1,0) [0|100] "V" D3
 SG_ OTHER : 16|8@1+ (1,0) [0|255] "" D3
SG_MUL_VAL_ 513 TORQUE REGISTER 144-144;
SG_MUL_VAL_ 513 DISABLE REGISTER 81-81;
SG_MUL_VAL_ 513 ASKED REGISTER 61-61;
SG_MUL_VAL_ 513 SPEED_MS ASKED 48-48;
SG_MUL_VAL_ 513 STATUS_MS ASKED 64-64;
"""
SIGNALS = Signals.model_validate(
    {
        "boost_voltage_V": "TX.CURRENT",
        "output": {"signal": "TX.SPEED", "unit": "rpm"},
        "bridge": {"signal": "TX.STATUS", "on": 1},
        "fault": "TX.ERRORS",
        "command": {
            "boost_reference_V": "RX.TORQUE",
            "bridge": {"signal": "RX.DISABLE", "on": 0, "off": 4},
            "constants": {"WAKE.CALL": 3},
        },
    }
)
TIMING = Timing(half_cycle_s=0.01, stale_s=0.5, voltage_parts=frozenset())


def bus_of(folder: Path, clock: str, setup: Mapping[str, float] | None = None) -> CanBus:
    database = folder / "registers.dbc"
    database.write_text(DBC)
    tables = {"interface": "virtual", "channel": "registers", "database": database}
    return CanBus.model_validate({"type": "can", "clock": clock, "setup": setup or {}} | tables)


def mapped(folder: Path, setup: Mapping[str, float], clock: str = "TX") -> CanMapping:
    named = {f"RX.{name}": value for name, value in setup.items()}
    return map_drive(bus_of(folder, clock, named), SIGNALS, TIMING)


def page(register: int, value: int, length: int = 4) -> bytes:
    """A reply of a register, as long as its value and one byte."""
    return struct.pack("<Bq", register, value)[:length].ljust(length, b"\0")


async def deliver(port: can_port.Port, drive: can.BusABC, data: bytes) -> None:
    """Send a frame of the drive, and wait until the port has read it."""
    known = port.statistics.received
    drive.send(can.Message(arbitration_id=385, is_extended_id=False, data=data))
    await until(lambda: port.statistics.received > known)


@pytest.mark.parametrize(
    ("data", "verdict", "values"),
    [
        (page(SPEED, 300), "good", {"SPEED": 150.0}),
        (page(SPEED, -2, 3), "good", {"SPEED": -1.0}),
        (page(STATUS, 1, 6), "good", {"STATUS": 1}),
        (page(STATUS, 1, 5), "good", {"STATUS": 1}),
        (page(STATUS, 1, 4), "wrong_length", {}),
        (page(SPEED, 300, 2), "wrong_length", {}),
        (b"", "wrong_length", {}),
    ],
)
def test_a_frame_needs_the_bytes_of_its_own_page(
    tmp_path: Path, data: bytes, verdict: str, values: dict[str, float]
) -> None:
    (status,) = mapped(tmp_path, {}).statuses
    decoded = status.codec.decode(data)
    assert (str(decoded[0]), dict(decoded[1])) == (verdict, values)
    if verdict == "wrong_length":
        needed = {0: 1, 2: 3, 4: 5}[len(data)]
        assert status.codec.required(data) == needed


async def test_one_page_is_the_clock(tmp_path: Path) -> None:
    """Readings come with the speed alone, whether or not its value is within its range."""
    bus, ear = bus_of(tmp_path, "TX.SPEED"), Ear()
    clock = asyncio.get_running_loop().time
    port = can_port.Port(bus, map_drive(bus, SIGNALS, TIMING), clock, clock)
    async with running(port, ear):
        with open_bus(bus) as drive:
            pages = [page(CURRENT, 7), page(STATUS, 1, 6), page(ERRORS, 0), page(SPEED, 300)]
            pages += [page(SPEED, 14000), page(CURRENT, 9), page(SPEED, 302)]
            for data in pages:
                drive.send(can.Message(arbitration_id=385, is_extended_id=False, data=data))
            await until(lambda: port.statistics.received == len(pages))
            await ear.hears(3)
    assert [one.boost_voltage_V for one in ear.readings] == pytest.approx([0.7, 0.7, 0.9])
    assert len(ear.readings) == 3


@pytest.mark.parametrize(
    ("clock", "words"),
    [("TX.SPEEDS", "did you mean 'SPEED'"), ("TX.REGISTER", "no entry of [signals] is taken from")],
)
def test_a_clock_that_is_no_page_of_the_readings_is_refused(
    tmp_path: Path, clock: str, words: str
) -> None:
    with pytest.raises(ConfigurationError) as refused:
        mapped(tmp_path, {}, clock)
    (flaw,) = refused.value.flaws
    assert (flaw.place, words in flaw.message) == ("bus.clock", True)


def test_requests_go_once_in_pages_of_the_commands_message_that_no_command_uses(
    tmp_path: Path,
) -> None:
    mapping = mapped(tmp_path, {"SPEED_MS": 10.0, "STATUS_MS": 100.0})
    once = {order.encode(SAFE_COMMAND) for order in mapping.setup}
    assert once == {bytes((ASK, SPEED, 10)), bytes((ASK, STATUS, 100))}
    always = {order.encode(SAFE_COMMAND) for order in mapping.orders}
    assert always == {bytes((TORQUE, 0, 0)), bytes((DISABLE, 4, 0)), bytes((3,))}


async def test_requests_go_again_to_a_drive_that_is_off_and_has_fallen_silent(
    tmp_path: Path,
) -> None:
    """One that was switched off and on again has forgotten them, and sends nothing."""
    bus, ear, clock = bus_of(tmp_path, "TX.SPEED", {"RX.SPEED_MS": 10.0}), Ear(), Clock()
    port = can_port.Port(bus, map_drive(bus, SIGNALS, TIMING), clock, clock)
    asked = []
    with open_bus(bus) as drive:
        async with running(port, ear):
            await until(lambda: drive.recv(0) is not None)
            for number in range(40):
                await deliver(port, drive, page(SPEED if number < 10 else CURRENT, 7))
                assert port.send(SAFE_COMMAND)
                frames = iter(lambda: drive.recv(0), None)
                asked.append(any(one.data[0] == ASK for one in frames))
                clock.now_s += 0.125
    assert [number for number, one in enumerate(asked) if one] == [18, 27, 36]


@pytest.mark.parametrize("name", ["TORQUE", "DISABLE"])
def test_a_set_up_on_a_page_of_the_command_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match="'RX' carries the command: name a constant"):
        mapped(tmp_path, {name: 1.0})


async def test_a_message_of_constants_goes_at_its_own_rate_and_at_once_with_the_bridge(
    tmp_path: Path,
) -> None:
    bus, ear, clock = bus_of(tmp_path, "TX"), Ear(), Clock()
    bus = bus.model_copy(update={"send_every_s": {"WAKE": 0.1}})
    port = can_port.Port(bus, map_drive(bus, SIGNALS, TIMING), clock, clock)
    run = replace(SAFE_COMMAND, bridge=True)
    ids: list[list[int]] = []
    async with running(port, ear):
        with open_bus(bus) as drive:
            for data in (page(CURRENT, 7), page(STATUS, 0, 6), page(ERRORS, 0), page(SPEED, 300)):
                drive.send(can.Message(arbitration_id=385, is_extended_id=False, data=data))
            await ear.hears(1)
            for command in [SAFE_COMMAND] * 25 + [run] * 15:
                assert port.send(command)
                clock.now_s += 0.01
                port.monitor.report(on=command.bridge, asked_s=clock.now_s, came_s=clock.now_s)
                ids.append([one.arbitration_id for one in iter(lambda: drive.recv(0), None)])
    assert [number for number, one in enumerate(ids) if 514 in one] == [0, 10, 20, 25, 35]
    assert all(one.count(513) == 2 for one in ids)


def copying(folder: Path, **copies: object) -> CanMapping:
    command = SIGNALS.command.model_dump(exclude_none=True) | {"copies": copies}
    tables = SIGNALS.model_dump(exclude_none=True) | {"command": command}
    return map_drive(bus_of(folder, "TX"), Signals.model_validate(tables), TIMING)


async def test_a_measured_value_is_copied_into_the_command_while_it_is_fresh(
    tmp_path: Path,
) -> None:
    copy = {"signal": "BACK.VOLTS", "scale": 0.5}
    mapping, ear, clock = copying(tmp_path, boost_voltage_V=copy), Ear(), Clock()
    bus, heard = bus_of(tmp_path, "TX"), []
    port = can_port.Port(bus, mapping, clock, clock)
    with open_bus(bus) as drive:
        async with running(port, ear):
            for current, later_s in ((None, 0.0), (70, 0.4), (None, 0.2), (600, 0.0), (-1, 0.0)):
                if current is not None:
                    await deliver(port, drive, page(CURRENT, current))
                clock.now_s += later_s
                assert port.send(SAFE_COMMAND)
                frames = {one.arbitration_id: one.data for one in iter(lambda: drive.recv(0), None)}
                heard.append(int.from_bytes(frames[515][:2], "little"))
    assert heard == [0xFFFF, 140, 0xFFFF, 0xFFFF, 0xFFFF]


def test_a_copy_of_what_is_not_measured_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigurationError, match=r"does not send 'outputs' \(did you mean 'output'"
    ):
        copying(tmp_path, outputs="BACK.OTHER")


@pytest.mark.parametrize(
    ("name", "words"), [("RX", "carries boost_reference_V"), ("WAK", "did you mean 'WAKE'")]
)
def test_a_rate_of_what_is_commanded_is_refused(tmp_path: Path, name: str, words: str) -> None:
    bus = bus_of(tmp_path, "TX").model_copy(update={"send_every_s": {name: 0.1}})
    with pytest.raises(ConfigurationError) as refused:
        map_drive(bus, SIGNALS, TIMING)
    (flaw,) = refused.value.flaws
    assert (flaw.place, words in flaw.message) == (f"bus.send_every_s.{name}", True)
