"""Asking a running simulated drive for a disturbance, and waiting for its answer."""

from __future__ import annotations

import asyncio
import uuid
from contextlib import suppress
from typing import Any

import aiomqtt
import msgspec

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import conversation, end_of
from adaptdrive.operation.simulator import DeviceReply, simulator_topic

ANSWER_s = 5.0


async def ask(broker: Mqtt, drive: str, disturbance: dict[str, Any]) -> DeviceReply | None:
    """Ask for one disturbance.

    Args:
        broker: Where the drive listens.
        drive: Name of the drive.
        disturbance: The request without its id.

    Returns:
        The drive's answer; None when the drive gives none within five seconds.

    Raises:
        NoAnswerError: The broker does not answer or is lost; it is named, with its problem.
    """
    request = {"id": uuid.uuid4().hex, **disturbance}
    end_s = end_of(ANSWER_s)
    async with conversation(broker, drive, end_s) as client:
        await client.subscribe(simulator_topic(drive, "reply"), qos=1)
        await client.publish(simulator_topic(drive, "disturb"), msgspec.json.encode(request), qos=1)
        with suppress(TimeoutError):
            async with asyncio.timeout_at(end_s):
                return await _answer(client, request["id"])
    return None


async def _answer(client: aiomqtt.Client, request_id: str) -> DeviceReply | None:
    async for message in client.messages:
        reply = msgspec.json.decode(message.payload, type=DeviceReply)
        if reply.id == request_id:
            return reply
    return None
