"""The guide against a drive whose sensor is no longer heard, on a real broker."""

from __future__ import annotations

import asyncio
import json
import uuid
from datetime import UTC, datetime

import pytest
from aiomqtt import Client

from adaptdrive.commission.guide import Guide
from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from tests.support import Broker

PATIENCE_S = 60.0


async def publish_a_held_value(broker: Broker, drive: str) -> None:
    """Publish a drive in standby whose output is that of one measurement, which becomes older."""
    place, begin_s = f"adaptdrive/{drive}", asyncio.get_running_loop().time()
    content = {"boost_voltage_V": 280.0, "output": 1.0, "command": {"bridge": False}}
    async with Client(broker.host, broker.port) as client:
        await client.publish(f"{place}/availability", "online", retain=True)
        await client.publish(f"{place}/state", json.dumps({"state": "standby"}), retain=True)
        while True:
            age_s = asyncio.get_running_loop().time() - begin_s
            message = content | {"time": datetime.now(UTC).isoformat(), "age_s": age_s}
            await client.publish(f"{place}/telemetry/drive", json.dumps(message))
            await asyncio.sleep(0.05)


async def test_a_value_that_is_held_is_no_measurement(mosquitto: Broker) -> None:
    drive = f"held-{uuid.uuid4()}"
    publishing = asyncio.create_task(publish_a_held_value(mosquitto, drive))
    await asyncio.sleep(1.0)
    settings = Mqtt(host=mosquitto.host, port=mosquitto.port)
    try:
        async with asyncio.timeout(PATIENCE_S):
            with pytest.raises(NoAnswerError, match="no measurement for 4 s"):
                await Guide(settings, drive, 20.0).watch_standby(30.0)
    finally:
        publishing.cancel()
        await asyncio.wait([publishing])
