"""The contract on a broker that knows MQTT 3.1.1 only."""

from __future__ import annotations

import asyncio
import importlib.util
import sys
from pathlib import Path

import pytest

from adaptdrive.runtime.requests import SetSetpoint
from tests.operation.peers import PATIENCE_S, ask, expect_retained, listening, publish, serving
from tests.support import Broker, Spawn, serve_promptly

PROGRAM = Path(__file__).with_name("amqtt_broker.py")


@pytest.fixture
async def older(free_tcp_port: int, spawn: Spawn) -> Broker:
    if importlib.util.find_spec("amqtt") is None:
        pytest.skip("amqtt is not installed")
    broker = spawn(sys.executable, PROGRAM, str(free_tcp_port))
    async with asyncio.timeout(PATIENCE_S):
        while True:
            try:
                _, writer = await asyncio.open_connection("127.0.0.1", free_tcp_port)
            except OSError:
                await asyncio.sleep(0.05)
            else:
                writer.close()
                await writer.wait_closed()
                serve_promptly(broker.pid)
                return Broker("127.0.0.1", free_tcp_port)


async def test_commands_are_answered(older: Broker, tmp_path: Path) -> None:
    async with serving(older, "older", tmp_path) as bench:
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert not (await ask(bench, "setpoint", '{"id": "b", "value": 9}'))["accepted"]
    assert bench.host.asked == [SetSetpoint(1.0)]
    await expect_retained(bench, "availability", "offline")


async def test_what_comes_as_retained_at_subscription_is_refused(
    older: Broker, tmp_path: Path
) -> None:
    await publish(older, "adaptdrive/older/command/setpoint", '{"id": "a", "value": 1}', "-r")
    async with (
        listening(older, "adaptdrive/older/reply") as ear,
        serving(older, "older", tmp_path) as bench,
    ):
        assert "retain" in (await ear.on("adaptdrive/older/reply")).content["reason"]
        assert (await ask(bench, "setpoint", '{"id": "b", "value": 2}'))["accepted"]
    assert bench.host.asked == [SetSetpoint(2.0)]
