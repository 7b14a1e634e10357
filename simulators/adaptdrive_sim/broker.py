"""The simulator's own topics on an MQTT broker.

    adaptdrive-sim/DRIVE/disturb   requests, see `adaptdrive_sim.disturbances`; never retained
    adaptdrive-sim/DRIVE/reply     the answer to each: id, accepted, reason
    adaptdrive-sim/DRIVE/truth     retained, once a second: what an estimator is to find, and
                                   the disturbances that the device offers

The truth is removed when the simulated drive goes away, by its last will if need be.
"""

from __future__ import annotations

import asyncio
import re
import uuid
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import aiomqtt
import msgspec

from adaptdrive.config.services import Mqtt, check_host
from adaptdrive.errors import RefusedError
from adaptdrive.operation.conversation import conversation, end_of
from adaptdrive.operation.simulator import DeviceReply, simulator_topic


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """Address of a broker."""

    host: str
    port: int

    @property
    def mqtt(self) -> Mqtt:
        """The broker, in the words of the configuration."""
        return Mqtt(host=self.host, port=self.port)


def parse_address(text: str) -> BrokerAddress:
    """Read `HOST:PORT`, where an IPv6 address stands in brackets; the port may be left out.

    Raises:
        RefusedError: It is no such thing.
    """
    match = re.fullmatch(r"(\[[^\]]+\]|[^:\s]+)(?::(\d{1,5}))?", text)
    if match is None:
        raise RefusedError(f"broker {text!r} is not HOST:PORT")
    port = int(match[2] or 1883)
    if not 1 <= port <= 65535:
        raise RefusedError(f"broker {text!r}: port {port} must lie in 1…65535")
    try:
        return BrokerAddress(check_host(match[1].strip("[]")), port)
    except ValueError as problem:
        raise RefusedError(f"broker {text!r}: {problem}") from problem


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
