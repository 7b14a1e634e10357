"""An interface that goes down or away under the port: bus-off, or an adapter that is unplugged."""

from __future__ import annotations

import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.can.bus import open_bus
from adaptdrive.util.errors import BusError
from tests.system.vcan.peers import Link
from tests.unit.devices.bench import Drive, Ear, build_port, running, until

pytestmark = [pytest.mark.vcan, pytest.mark.proof]


def rejoined(drive: Drive, config: CanBus) -> Drive:
    """The same drive on the interface that is up again."""
    drive.bus.shutdown()
    drive.bus = open_bus(config)
    return drive


async def test_an_interface_that_goes_down_is_reported_and_used_again_once_it_is_up(
    config: CanBus, drive: Drive, ear: Ear, link: Link
) -> None:
    port = build_port(config)
    async with running(port, ear):
        drive.send_both()
        await ear.hears(1)
        link("set", "down")
        await until(lambda: len(ear.bus) == 1)
        assert ear.bus[0][0] is False
        assert f"socketcan {config.channel}: " in ear.bus[0][1]
        assert not port.send(SAFE_COMMAND)
        link("set", "up")
        await until(lambda: len(ear.bus) == 2)
        assert ear.bus[1] == (True, f"socketcan {config.channel}")
        assert port.send(SAFE_COMMAND)
        rejoined(drive, config).send_load()
        await until(lambda: port.statistics.received == 3)
        assert len(ear.readings) == 1  # what was heard before the loss is not used after it
        drive.send_both()
        await ear.hears(2)
        counts = port.statistics
    assert (counts.reconnects, counts.sent, counts.send_drops) == (1, 1, 1)


async def test_an_adapter_may_be_unplugged_and_plugged_in_again(
    config: CanBus, drive: Drive, ear: Ear, link: Link
) -> None:
    port = build_port(config)
    async with running(port, ear):
        link("delete")
        await until(lambda: len(ear.bus) == 1)
        assert not port.send(SAFE_COMMAND)
        link("add", "type", "vcan")
        link("set", "up")
        await until(lambda: len(ear.bus) == 2)
        rejoined(drive, config).send_both()
        await ear.hears(1)
    assert [up for up, _ in ear.bus] == [False, True]


async def test_an_interface_that_is_down_at_the_start_is_named_with_what_to_do(
    config: CanBus, ear: Ear, link: Link
) -> None:
    link("set", "down")
    advice = f"the interface is down; try: ip link set {config.channel} up$"
    with pytest.raises(BusError, match=f"socketcan {config.channel}: {advice}"):
        await build_port(config).run(ear, lambda: None)
    assert ear.bus == []
