"""Messages that come only when asked: a device that answers requests and says nothing else."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path

import can
import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.config.root import CanSensorSection
from adaptdrive.devices.can import port as can_port
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.devices.can.kind import build_can_sensors
from adaptdrive.devices.can.mapping import map_drive
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.interlocks import Limits, find_cause
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.quantity import Display
from tests.support import text_of
from tests.unit.devices.bench import (
    LOAD,
    PATIENCE_S,
    STATUS,
    TIMING,
    Drive,
    Ear,
    SensorEar,
    build_port,
    memory_bus,
    motor_signals,
    rewritten,
    running,
    until,
)

LIMITS = Limits(430.0, 5.0, Display("V"))
STATUS_ID, LOAD_ID, COMMAND_ID = 0x18FF1027, 0x18FF1127, 0x18EF2717
"""Proprietary groups 65296 and 65297 of the drive at 0x27, and its command from 0x17."""


class Device:
    """Answers what a request asks for, and nothing else.

    Attributes:
        answers: Whether it does.
        asked: The requests, in their order.
    """

    def __init__(self, bus: can.BusABC, ids: dict[str, int], *, group: bool) -> None:
        self._drive = Drive(bus)
        self._ids = ids
        self._group = group
        self.answers = True
        self.asked: list[can.Message] = []

    async def run(self) -> None:
        while True:
            while (frame := self._drive.bus.recv(0)) is not None:
                for name, number in self._ids.items():
                    if self._asks(frame, number):
                        self.asked.append(frame)
                        self._answer(name, number)
            await asyncio.sleep(0.001)

    def _asks(self, frame: can.Message, number: int) -> bool:
        if not self._group:
            return frame.is_remote_frame and frame.arbitration_id == number
        sender, wanted = number & 0xFF, (number >> 8 & 0xFFFF).to_bytes(3, "little")
        to_us = frame.arbitration_id & 0x1FFFFF00 in {0x18EA0000 | sender << 8, 0x18EAFF00}
        return frame.is_extended_id and to_us and bytes(frame.data) == wanted

    def _answer(self, name: str, number: int) -> None:
        if not self.answers:
            return
        values = STATUS if name == "DriveStatus" else LOAD | {"HalfCycle": len(self.asked) // 2}
        data = self._drive.frame(name, **values)
        long = number > 0x7FF
        self._drive.bus.send(can.Message(arbitration_id=number, is_extended_id=long, data=data))


@contextlib.asynccontextmanager
async def answering(config: CanBus | CanSensorSection, **ids: int) -> AsyncIterator[Device]:
    """Run a device on a bus until the block ends."""
    with open_bus(config) as bus:
        device = Device(bus, ids, group="pgn" in config.polled.values())
        task = asyncio.create_task(device.run())
        try:
            yield device
        finally:
            task.cancel()
            await asyncio.wait([task])
    assert task.cancelled()


@pytest.fixture
def config() -> CanBus:
    return memory_bus()


def by_remote_frames(config: CanBus, _: Path) -> tuple[CanBus, dict[str, int]]:
    polled = {"DriveStatus": "rtr", "DriveLoad": "rtr"}
    return config.model_copy(update={"polled": polled}), {"DriveStatus": 0x100, "DriveLoad": 0x101}


def by_groups(config: CanBus, folder: Path) -> tuple[CanBus, dict[str, int]]:
    numbers = {" 256 ": STATUS_ID, " 257 ": LOAD_ID, " 128 ": COMMAND_ID}
    changed = rewritten(
        folder, *((old, f" {new | 1 << 31} ") for old, new in numbers.items()), bus=config
    )
    polled = {"DriveStatus": "pgn", "DriveLoad": "pgn"}
    found = changed.model_copy(update={"polled": polled})
    return found, {"DriveStatus": STATUS_ID, "DriveLoad": LOAD_ID}


Described = Callable[[CanBus, Path], tuple[CanBus, dict[str, int]]]


@pytest.mark.parametrize("described", [by_remote_frames, by_groups])
async def test_a_drive_that_answers_only_is_read_each_half_cycle_until_it_is_silent(
    config: CanBus, described: Described, tmp_path: Path
) -> None:
    bus, ids = described(config, tmp_path)
    port, ear = build_port(bus), Ear()
    async with answering(bus, **ids) as device, running(port, ear):
        await ear.hears(1)
        started_s, known = asyncio.get_running_loop().time(), len(device.asked)
        await until(lambda: len(device.asked) > known + 60)
        assert (asyncio.get_running_loop().time() - started_s) / 30 > 0.8 / 120
        assert cause(port, ear.readings[-1]) is None
        assert ear.readings[-1].boost_voltage_V == pytest.approx(STATUS["BoostVoltage"])
        assert ear.readings[-1].bridge
        device.answers = False
        known = len(device.asked)
        await until(lambda: cause(port, ear.readings[-1]) is not None)
        assert "no reply to its requests: check bus.polled" in (cause(port, ear.readings[-1]) or "")
        assert port.explain_age().kind is TripKind.MESSAGE_MISSING
        await until(lambda: len(device.asked) > known)
        device.answers = True
        known = len(ear.readings)
        await ear.hears(known + 3)
        assert cause(port, ear.readings[-1]) is None


def cause(port: can_port.Port, reading: Reading) -> str | None:
    now_s = asyncio.get_running_loop().time()
    return text_of(find_cause(reading, now_s, LIMITS, 0.05, port.explain_age))


async def test_a_remote_frame_has_the_length_that_the_dbc_states(
    config: CanBus, tmp_path: Path
) -> None:
    bus, ids = by_remote_frames(config, tmp_path)
    async with answering(bus, **ids) as device, running(build_port(bus), Ear()):
        await until(lambda: len(device.asked) > 4)
    assert {(one.dlc, bytes(one.data)) for one in device.asked} == {(8, b"")}


@pytest.mark.parametrize(
    ("frame_id", "request_id", "data"),
    [
        (0x18FF10FE, 0x18EAFFF9, b"\x10\xff\x00"),
        (0x18EF5527, 0x18EA2755, b"\x00\xef\x00"),
        (0x19F21427, 0x18EA27F9, b"\x14\xf2\x01"),
    ],
    ids=["to all, for a sender without an address", "from the address it replies to", "page 1"],
)
async def test_a_request_goes_out_from_and_to_the_addresses_that_the_id_has(
    config: CanBus, tmp_path: Path, frame_id: int, request_id: int, data: bytes
) -> None:
    bus, _ = by_groups(config, tmp_path)
    text = bus.database[0].read_text(encoding="utf-8")
    numbers = f" {STATUS_ID | 1 << 31} ", f" {frame_id | 1 << 31} "
    bus.database[0].write_text(text.replace(*numbers), encoding="utf-8")
    polled = bus.model_copy(update={"polled": {"DriveStatus": "pgn"}})
    with open_bus(polled) as other:
        async with running(build_port(polled), Ear()):
            found: list[can.Message] = []
            async with asyncio.timeout(PATIENCE_S):
                while len(found) < 5:
                    found.extend(iter(partial(other.recv, 0), None))
                    await asyncio.sleep(0.001)
    assert {(one.arbitration_id, bytes(one.data)) for one in found} == {(request_id, data)}


async def test_a_lost_bus_is_not_asked_and_asked_again_when_it_is_back(
    config: CanBus, tmp_path: Path
) -> None:
    bus, ids = by_remote_frames(config, tmp_path)
    port, ear = build_port(bus), Ear()
    async with answering(bus, **ids) as device, running(port, ear):
        await ear.hears(1)
        assert port._connection.bus is not None
        port._connection.bus.shutdown()
        await until(lambda: bool(ear.bus))
        drops = port.statistics.send_drops
        await until(lambda: port.statistics.reconnects == 1)
        assert port.statistics.send_drops == drops
        known = len(device.asked)
        await until(lambda: len(device.asked) > known + 4)


@pytest.mark.parametrize("how", ["rtr", "pgn"])
async def test_sensors_are_asked_each_cycle_and_their_silence_is_told(
    tmp_path: Path, how: str
) -> None:
    ids = {"DriveStatus": STATUS_ID if how == "pgn" else 0x100}
    number = ids["DriveStatus"] | (how == "pgn") << 31
    database = rewritten(tmp_path, (" 256 ", f" {number} ")).database[0]
    given = {
        "name": "bench",
        "type": "can",
        "interface": "virtual",
        "channel": "polled",
        "database": str(database),
        "polled": {"DriveStatus": how},
        "cycle_s": 0.05,
        "signals": {"power": {"signal": "DriveStatus.LoadPower"}},
    }
    config = CanSensorSection.model_validate(given, strict=False)
    port, ear = (
        build_can_sensors(config, "sensor_bus.0", asyncio.get_running_loop().time),
        SensorEar(),
    )
    async with answering(config, **ids) as device, asyncio.TaskGroup() as tasks:
        task = tasks.create_task(port.run(ear))
        await ear.hears(5)
        times_s = [came_s for _, _, came_s in ear.heard]
        assert times_s[4] - times_s[0] > 4 * 0.04
        assert ear.latest == {"power": pytest.approx(STATUS["LoadPower"])}
        device.answers = False
        await until(lambda: bool(ear.bus))
        assert "no good frame for 0.15 s" in ear.bus[0][1]
        assert port.statistics.sent >= 5
        task.cancel()


async def test_a_short_frame_is_refused_with_its_message_its_dlc_and_what_is_needed(
    config: CanBus,
) -> None:
    bus = config.model_copy(update={"integrity": {}})
    port, ear = build_port(bus), Ear()
    with open_bus(bus) as other:
        async with running(port, ear):
            drive = Drive(other)
            drive.put("DriveLoad", drive.frame("DriveLoad", **LOAD)[:7])
            drive.put("DriveStatus", drive.frame("DriveStatus", **STATUS)[:5])
            await until(lambda: port.statistics.wrong_length == 1)
            assert "(wrong_length, 1 in a row): DLC 5, needed 7: " in str(port.explain_age())
            (refused,) = port.details()
            assert refused.startswith("refused 0x100 (DriveStatus): wrong_length 1 x, last [")
            drive.put("DriveStatus", drive.frame("DriveStatus", **STATUS)[:7])
            drive.put("DriveLoad", drive.frame("DriveLoad", **LOAD)[:7])
            await ear.hears(1)
    assert ear.readings[0].boost_voltage_V == pytest.approx(STATUS["BoostVoltage"])


async def test_an_unused_id_of_j1939_is_listed_with_its_sender(
    config: CanBus,
) -> None:
    port = can_port.Port(
        config,
        map_drive(config, motor_signals(), TIMING),
        asyncio.get_running_loop().time,
        takes_all=True,
    )
    with open_bus(config) as other:
        async with running(port, Ear()):
            other.send(can.Message(arbitration_id=0x18EF1727, data=b"\x01"))
            await until(lambda: bool(port.details()))
            (line,) = port.details()
    assert line.startswith("refused 0x18EF1727 from 0x27 of J1939: no entry of [signals]")
