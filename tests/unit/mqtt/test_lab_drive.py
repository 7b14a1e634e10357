"""A drive as a program of the lab sees it: live, or not at all."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Any

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.lab import Drive
from adaptdrive.mqtt.client import NoAnswerError, follow
from tests.unit.mqtt.memory_broker import MemoryBroker


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


@pytest.mark.parametrize(
    ("availability", "problem"), [("offline", "offline"), ("online", "no telemetry")]
)
async def test_the_state_of_a_daemon_that_is_gone_is_no_state(
    broker: MemoryBroker, availability: str, problem: str
) -> None:
    leave_behind(broker, availability)
    with pytest.raises(NoAnswerError, match=problem):
        await Drive("motor", Mqtt()).state()


async def test_telemetry_that_the_broker_has_kept_is_shown_nowhere(broker: MemoryBroker) -> None:
    leave_behind(broker, "online")
    async with (
        aclosing(Drive("motor", Mqtt()).telemetry()) as messages,
        aclosing(follow(Mqtt(), "motor")) as live,
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
