"""Asking a running simulated drive for a disturbance, and waiting for its answer."""

from __future__ import annotations

import asyncio
import uuid
from typing import Any

import aiomqtt
import msgspec

from adaptdrive.operation.simulator import DeviceReply, simulator_topic
from adaptdrive_sim.broker import BrokerAddress

ANSWER_s = 5.0


async def ask(broker: BrokerAddress, drive: str, disturbance: dict[str, Any]) -> DeviceReply | None:
    """Ask for one disturbance.

    Args:
        broker: Where the drive listens.
        drive: Name of the drive.
        disturbance: The request without its id.

    Returns:
        The drive's answer; None when the broker or the drive gives none within five seconds.
    """
    request = {"id": uuid.uuid4().hex, **disturbance}
    try:
        async with asyncio.timeout(ANSWER_s), aiomqtt.Client(broker.host, broker.port) as client:
            await client.subscribe(simulator_topic(drive, "reply"), qos=1)
            await client.publish(
                simulator_topic(drive, "disturb"), msgspec.json.encode(request), qos=1
            )
            return await _answer(client, request["id"])
    except (TimeoutError, aiomqtt.MqttError):
        return None


async def _answer(client: aiomqtt.Client, request_id: str) -> DeviceReply | None:
    async for message in client.messages:
        reply = msgspec.json.decode(message.payload, type=DeviceReply)
        if reply.id == request_id:
            return reply
    return None
