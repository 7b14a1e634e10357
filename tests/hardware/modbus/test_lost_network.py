"""A network that is lost and comes back: no command from before reaches the drive after it."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys

import pytest

from adaptdrive.control.signals import SAFE_COMMAND
from tests.hardware.bench import until
from tests.hardware.modbus.bench import RUN, Wire

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
async def test_a_lost_network_delivers_no_command_when_it_comes_back(tcp: Wire) -> None:
    async with tcp.bench(**PROMPT) as one:
        one.port.send(RUN)
        await until(lambda: bool(one.peer.writes) and one.told()[1] == 1)
        loopback("down")
        known = len(one.peer.writes)
        await until(lambda: bool(one.ear.bus))
        one.port.send(SAFE_COMMAND)
        loopback("up")
        await until(lambda: one.told() == [0, 0])
        await asyncio.sleep(RETRANSMITTED_S)
        assert {tuple(words[:2]) for _, words in one.peer.writes[known:]} == {(0, 0)}


def loopback(state: str) -> None:
    subprocess.run(["ip", "link", "set", "lo", state], check=True)
