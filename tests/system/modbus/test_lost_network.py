"""A network that is lost and comes back: no command from before reaches the drive after it."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from tests.unit.described.modbus_node import ModbusNode
from tests.unit.devices.bench import Ear, until
from tests.unit.devices.modbus.bench import RUN, build

pytestmark = [pytest.mark.proof, pytest.mark.usefixtures("outside")]
ALONE = ["unshare", "--map-root-user", "--net", "sh", "-c"]
OWN_NETWORK = "ADAPTDRIVE_TESTS_OWN_NETWORK"
DELIVERS = "test_a_lost_network_delivers_no_command_when_it_comes_back"
PROMPT = {"bus__poll_ticks": "3", "bus__timeout_s": "0.02"}
"""Polls of which three are over before the kernel sends a command again."""

RETRANSMITTED_S = 2.0
"""Time in which a kernel that keeps a command sends it again after so short a loss."""


def test_a_command_from_before_the_loss_is_never_delivered() -> None:
    """A machine of its own, whose loopback is taken down."""
    up = "ip link set lo up"
    if subprocess.run([*ALONE, up], check=False, capture_output=True).returncode:
        pytest.skip("needs unshare, ip and user namespaces")
    delivers = f"{sys.executable} -m pytest -q -p no:cacheprovider {__file__} -k {DELIVERS}"
    run = subprocess.run(
        [*ALONE, f"{up} && {OWN_NETWORK}=1 {delivers}"],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stdout
    assert "1 passed" in run.stdout


@pytest.mark.skipif(OWN_NETWORK not in os.environ, reason="takes the network of its machine down")
async def test_a_lost_network_delivers_no_command_when_it_comes_back() -> None:
    node, ear = ModbusNode({4, 16}, framing="tcp"), Ear()
    node.put("input", 0, 30012, 1204, 1, 0x4050, 0, 1)
    node.put("holding", 0, 0, 0, 0)
    server = await asyncio.start_server(node.serve, "127.0.0.1", 0)
    port = build(bus__port=str(server.sockets[0].getsockname()[1]), **PROMPT)
    task = asyncio.create_task(port.run(ear, lambda: None))
    await until(lambda: bool(ear.readings))
    port.send(RUN)
    await until(lambda: 1 in node.written(1))
    loopback("down")
    known = len(node.writes)
    await until(lambda: bool(ear.bus))
    port.send(SAFE_COMMAND)
    loopback("up")
    await until(lambda: len(node.writes) > known)
    await asyncio.sleep(RETRANSMITTED_S)
    assert {word for address, word in node.writes[known:] if address < 2} == {0}
    task.cancel()
    await asyncio.wait([task])
    server.close()


def loopback(state: str) -> None:
    subprocess.run(["ip", "link", "set", "lo", state], check=True)
