"""A drive as a program on asyncio sees it: live, or not at all."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Any

import pytest
from aiomqtt import Message

from adaptdrive.connected import accepted
from adaptdrive.mqtt.client import follow, read_status, send_command, telemetry
from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import Reply, encode
from adaptdrive.runtime.reports import State
from adaptdrive.util.errors import RefusedError
from tests.unit.mqtt.memory_broker import MemoryBroker, MemoryClient


def leave_behind(broker: MemoryBroker, availability: str) -> None:
    """What a broker keeps of a daemon that lost its power while the drive ran."""
    kept = {
        "availability": availability,
        "state": '{"state": "running"}',
        "telemetry/load": '{"time": "2026-11-21T01:22:09Z", "output": 3.1}',
        "telemetry/drive": '{"output": 9.9}',
    }
    for topic, payload in kept.items():
        broker.publish(f"adaptdrive/motor/{topic}", payload.encode(), retain=True)


@pytest.mark.parametrize("availability", ["offline", "online"])
async def test_the_state_of_a_daemon_that_is_gone_is_no_state(
    broker: MemoryBroker, availability: str
) -> None:
    leave_behind(broker, availability)
    found = await read_status(Broker(), "motor", 5.0)
    assert (found.online, found.silent) == ((availability == "online"),) * 2
    assert not found.live


@pytest.mark.parametrize("kind", ["over-voltage", "of-a-later-version", None])
async def test_a_refusal_for_a_trip_names_its_kind(broker: MemoryBroker, kind: str | None) -> None:
    client = MemoryClient(broker)

    def refuse(message: Message) -> None:
        asked = json.loads(bytes(message.payload))
        reply = Reply(asked["id"], "reset", False, "no", State.TRIPPED, kind)
        broker.publish("adaptdrive/motor/reply", encode(reply))

    async def talk() -> None:
        while True:
            broker.publish("adaptdrive/motor/telemetry/drive", b'{"time": "2026-11-21T01:22:09Z"}')
            await asyncio.sleep(0.5)

    client.receive = refuse
    async with client:
        await client.subscribe("adaptdrive/motor/command/#")
        talking = asyncio.create_task(talk())
        with pytest.raises(RefusedError) as refusal:
            accepted(await send_command(Broker(), "motor", "reset", None, 5.0))
        talking.cancel()
    assert refusal.value.kind == (kind or "")


async def test_telemetry_that_the_broker_has_kept_is_shown_nowhere(broker: MemoryBroker) -> None:
    leave_behind(broker, "online")
    async with (
        aclosing(telemetry(Broker(), "motor")) as messages,
        aclosing(follow(Broker(), "motor")) as live,
    ):
        reading = asyncio.ensure_future(anext(messages))
        waiting = asyncio.create_task(_first_drive(live))
        await asyncio.sleep(1.0)
        broker.publish("adaptdrive/motor/telemetry/drive", b"{")
        broker.publish("adaptdrive/motor/telemetry/drive", b'{"output": 3.2}')
        assert await reading == ("drive", {"output": 3.2})
        assert await waiting == {"output": 3.2}


async def _first_drive(messages: AsyncGenerator[tuple[str, dict[str, Any]], None]) -> object:
    async for topic, content in messages:
        if topic == "telemetry/drive":
            return content
    return None
