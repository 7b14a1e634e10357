"""A CiA 402 node on the kernel's own CAN interface."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from tests.hardware.bench import until
from tests.hardware.canopen.bench import RUN, running
from tests.hardware.canopen.documents import bus_of, parse
from tests.hardware.canopen.peer import Peer
from tests.scenes.vcan.peers import Link

pytestmark = [pytest.mark.vcan, pytest.mark.proof]


@pytest.fixture
async def peer(channel: str) -> AsyncIterator[Peer]:
    on_kernel = {"interface": "socketcan", "channel": channel}
    peer = Peer(bus_of(parse()).model_copy(update=on_kernel))
    yield peer
    peer.close()


async def test_it_is_set_up_brought_up_and_down(peer: Peer) -> None:
    async with running(peer) as bench:
        await bench.run_drive()
        assert list(dict.fromkeys(peer.words)) == [0x00, 0x06, 0x07, 0x0F]
        assert bench.ear.readings[-1].boost_voltage_V == pytest.approx(250.0)
        assert bench.port.statistics.foreign == 0
        bench.ear.command = SAFE_COMMAND
        await until(lambda: not bench.ear.readings[-1].bridge)
        assert len(set(peer.beats)) == 1


async def test_an_interface_that_goes_down_trips_and_the_node_is_not_energised_again(
    peer: Peer, link: Link
) -> None:
    async with running(peer) as bench:
        await bench.run_drive()
        peer.leave()
        link("set", "down")
        await bench.complains("bus lost")
        link("set", "up")
        known = len(peer.words)
        bench.port.send(RUN)
        assert bench.port.complaint == "node 5: bus lost"
        bench.port.send(SAFE_COMMAND)
        bench.ear.command = SAFE_COMMAND
        peer.join()
        await until(lambda: bench.ear.bus[-1] == (True, f"{bench.port.description}: operational"))
        await bench.ready()
        assert set(peer.words[known:]) <= {0x00}
