"""The CAN port and the programs of can-utils, on an interface of the kernel."""

from __future__ import annotations

import asyncio

import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.control.signals import Command
from adaptdrive.devices.can import port as can_port
from adaptdrive.safety.facts import Reading
from tests.system.vcan.peers import CanUtils
from tests.unit.devices.bench import (
    Drive,
    Ear,
    build_port,
    reference_database,
    running,
    until,
    with_crc,
)

pytestmark = [pytest.mark.vcan, pytest.mark.proof]

COMMAND = Command(current_scale_S=0.04321, boost_reference_V=287.65, bridge=True)


async def test_candump_hears_each_command(config: CanBus, ear: Ear, can_utils: CanUtils) -> None:
    port = build_port(config)
    async with running(port, ear):
        with can_utils.dump(count=20) as heard:
            for _ in range(20):
                assert port.send(COMMAND)
    message = reference_database().get_message_by_name("DriveCommand")
    for number, frame in enumerate(heard):
        frame_id, _, digits = frame.partition("#")
        data = bytes.fromhex(digits)
        values = message.decode_simple(data, decode_choices=False)
        assert (frame_id, data) == ("080", with_crc(data))
        assert values["CurrentScale"] == pytest.approx(0.04321)
        assert values["BoostReference"] == pytest.approx(287.65)
        assert (values["BridgeEnable"], values["CommandAlive"]) == (1, number % 16)
    assert len(heard) == 20


@pytest.mark.parametrize(
    "frame",
    [
        "00000101#0011223344556677",  # extended id
        "101#R",  # remote
        "101##10011223344556677",  # CAN FD
        "102#0011223344556677",
        "101#",  # empty
        "101#00112233445566",  # short
    ],
)
async def test_other_frames_of_cansend_change_nothing(
    config: CanBus, drive: Drive, ear: Ear, can_utils: CanUtils, frame: str
) -> None:
    async with running(build_port(config), ear):
        drive.send_both()
        await ear.hears(1)
        can_utils.send(frame)
        drive.send_both()
        await ear.hears(2)
    assert [reading.counter for reading in ear.readings] == [0, 1]
    assert [reading.output for reading in ear.readings] == pytest.approx([3.123456] * 2)


class Answering(Ear):
    """Answers each reading."""

    port: can_port.Port

    def on_reading(self, reading: Reading) -> None:
        super().on_reading(reading)
        assert self.port.send(COMMAND)


async def test_a_bus_full_of_strangers_hides_nothing(
    config: CanBus, drive: Drive, can_utils: CanUtils
) -> None:
    """cangen fills the bus with ids that nobody asked for: the kernel keeps them from the port."""
    ear = Answering()
    ear.port = port = build_port(config)
    async with running(port, ear):
        load = can_utils.generate("-I", "3FF")
        await until(lambda: can_utils.carried > 100)
        before = can_utils.carried
        for number in range(100):
            drive.send_both()
            await ear.hears(number + 1)
        assert load.poll() is None
        strangers = can_utils.carried - before - 300
        assert strangers > 300
        counts = port.statistics
    assert (counts.received, counts.foreign, counts.counter_lost) == (200, 0, 0)
    assert (counts.sent, counts.send_drops) == (100, 0)
    assert [reading.counter for reading in ear.readings] == list(range(100))


async def has_read_all(port: can_port.Port) -> None:
    """Wait until nothing is left in the kernel's queue."""
    known = -1
    while known != port.statistics.received:
        known = port.statistics.received
        await asyncio.sleep(0.1)


async def test_a_flood_under_the_name_of_the_drive_is_refused_and_starves_nobody(
    config: CanBus, drive: Drive, ear: Ear, can_utils: CanUtils
) -> None:
    port = build_port(config)
    async with running(port, ear):
        drive.send_both()
        await ear.hears(1)
        flood = can_utils.generate("-I", "101", "-L", "8", "-D", "0011223344556677")
        await until(lambda: port.statistics.wrong_checksum > 2000)
        assert flood.poll() is None
        assert port.send(COMMAND)
        flood.terminate()
        await until(lambda: flood.poll() is not None)
        await has_read_all(port)
        drive.send_both()
        await ear.hears(2)
    assert [reading.counter for reading in ear.readings] == [0, 1]
