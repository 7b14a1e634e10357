"""Operators' commands and disturbances: sent to one drive, and its reply."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
import socket
import uuid
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any, TypeVar

import msgspec
from aiomqtt import Client

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.commands import LONGEST_USER, PING, STOP
from adaptdrive.operation.conversation import (
    TELEMETRY_WAIT_S,
    NoAnswerError,
    conversation,
    decoded,
    end_of,
)
from adaptdrive.operation.messages import (
    DISTURB,
    REPLY,
    DeviceReply,
    Reply,
    Topics,
    simulator_topic,
)

AnyReply = TypeVar("AnyReply", Reply, DeviceReply)

_FARTHEST_S = 3e9
"""Difference of a clock, 95 years, from which on it says nothing; one may have begun in 1970."""


class _Timed(msgspec.Struct):
    time: Annotated[datetime, msgspec.Meta(tz=True)]


async def send_command(
    broker: Mqtt, drive: str, verb: str, value: object, timeout_s: float, **fields: object
) -> Reply:
    """Send one command and wait for the reply to it; it expires when the wait ends.

    A `disable` never expires. The time is by the clock of the drive, taken from its telemetry. A
    drive without telemetry gets a `ping` first, and the command only after the reply to that: a
    network that stands still could deliver the command late, and the sender's clock may be ahead.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        verb: What to do.
        value: Value of the command, None for verbs that take none.
        timeout_s: Longest wait for the broker and the reply.
        fields: Fields of the payload other than the value.

    Raises:
        NoAnswerError: No reply in time, or no broker.
    """
    topics = Topics(drive)
    places = topics.command(verb), topics.reply
    end_s = end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        command = {"value": value, "user": _sender(), **fields}
        if verb != STOP:
            command = {"expires": await _expiry(client, drive, topics, end_s)} | command
        return await _ask(client, drive, places, command, Reply)


async def disturb(
    broker: Mqtt, drive: str, request: dict[str, Any], timeout_s: float
) -> DeviceReply:
    """Ask a simulated device for a disturbance and wait for its answer.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        request: Disturbance that the device offers.
        timeout_s: Longest wait for the broker and the answer.

    Raises:
        NoAnswerError: No answer in time, or no broker.
    """
    places = simulator_topic(drive, DISTURB), simulator_topic(drive, REPLY)
    end_s = end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        return await _ask(client, drive, places, request, DeviceReply)


async def _expiry(client: Client, drive: str, topics: Topics, end_s: float) -> str:
    """Return the time at which a wait ends, by the clock of the drive where it is heard."""
    patience_s = (end_s - asyncio.get_running_loop().time()) / 2.0
    ahead_s = await _clock_difference_s(client, topics, patience_s)
    if ahead_s is None:
        ping = {"expires": _moment(end_s)}
        await _ask(client, drive, (topics.command(PING), topics.reply), ping, Reply)
    return _moment(end_s, ahead_s or 0.0)


def _moment(end_s: float, ahead_s: float = 0.0) -> str:
    """Return a time of the event loop by a clock that is ahead of that of this machine."""
    left_s = end_s - asyncio.get_running_loop().time()
    return (datetime.now(UTC) + timedelta(seconds=left_s + ahead_s)).isoformat()


async def _clock_difference_s(client: Client, topics: Topics, patience_s: float) -> float | None:
    """Return how far the clock of a drive is ahead, None where no telemetry comes.

    Telemetry that comes late makes a command expire early, and never late.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(min(patience_s, TELEMETRY_WAIT_S)):
            await client.subscribe(topics.drive_telemetry)
            async for message in client.messages:
                told = decoded(bytes(message.payload), _Timed)
                if told is not None and not message.retain:
                    ahead_s = (told.time - datetime.now(UTC)).total_seconds()
                    return ahead_s if abs(ahead_s) < _FARTHEST_S else 0.0
    return None


async def _ask(
    client: Client,
    drive: str,
    places: tuple[str, str],
    content: dict[str, Any],
    kind: type[AnyReply],
) -> AnyReply:
    """Publish a request with an id on the first topic, and return its reply on the second."""
    asked, answered = places
    identity = str(uuid.uuid4())
    await client.subscribe(answered, qos=1)
    # a value may be a number of numpy, which JSON does not know
    payload = json.dumps(content | {"id": identity}, default=float)
    await client.publish(asked, payload, qos=1)
    async for message in client.messages:
        if message.topic.value == answered:
            reply = decoded(bytes(message.payload), kind)
            if reply is not None and reply.id == identity:
                return reply
    raise NoAnswerError(drive, "the broker closed the connection")


def _sender() -> str:
    """Return the sender that a command names: user and machine, unverified."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user id without a name
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()}"[:LONGEST_USER]
