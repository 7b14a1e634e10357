"""A drive as a program of the lab sees it: live, or not at all."""

from __future__ import annotations

import asyncio
import uuid
from contextlib import aclosing

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.lab import Drive
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import follow
from tests.operation.peers import publish
from tests.support import Broker


async def leave_behind(broker: Broker, drive: str, availability: str) -> None:
    """What a broker keeps of a daemon that lost its power while the drive ran."""
    kept = {
        "availability": availability,
        "state": '{"state": "running"}',
        "telemetry/load": '{"time": "2026-11-21T01:22:09Z", "output": 3.1}',
    }
    for topic, payload in kept.items():
        await publish(broker, f"adaptdrive/{drive}/{topic}", payload, "-r")


@pytest.mark.parametrize(
    ("availability", "problem"), [("offline", "offline"), ("online", "no telemetry")]
)
async def test_the_state_of_a_daemon_that_is_gone_is_no_state(
    mosquitto: Broker, availability: str, problem: str
) -> None:
    name = str(uuid.uuid4())
    await leave_behind(mosquitto, name, availability)
    drive = Drive(name, Mqtt(host=mosquitto.host, port=mosquitto.port))
    with pytest.raises(NoAnswerError, match=problem):
        await drive.state()


async def test_telemetry_that_the_broker_has_kept_is_not_yielded(mosquitto: Broker) -> None:
    name = str(uuid.uuid4())
    await leave_behind(mosquitto, name, "online")
    drive = Drive(name, Mqtt(host=mosquitto.host, port=mosquitto.port))
    async with aclosing(drive.telemetry()) as messages:
        first = asyncio.ensure_future(anext(messages))
        while not first.done():  # until it has subscribed
            await publish(mosquitto, f"adaptdrive/{name}/telemetry/drive", '{"output": 3.2}')
            await asyncio.wait([first], timeout=0.1)
        assert await first == ("drive", {"output": 3.2})


async def test_a_live_view_takes_no_telemetry_that_the_broker_has_kept(mosquitto: Broker) -> None:
    name = str(uuid.uuid4())
    await leave_behind(mosquitto, name, "online")
    await publish(mosquitto, f"adaptdrive/{name}/telemetry/drive", '{"output": 9.9}', "-r")
    seen = []
    async with aclosing(follow(Mqtt(host=mosquitto.host, port=mosquitto.port), name)) as messages:
        async for one in messages:
            seen.append(one)
            if one == ("telemetry/drive", {"output": 3.2}):
                break
            if one[0] == "state":  # kept, and needed: it has subscribed
                await publish(mosquitto, f"adaptdrive/{name}/telemetry/drive", '{"output": 3.2}')
    outputs = [content["output"] for topic, content in seen if topic == "telemetry/drive"]
    assert outputs == [3.2]
