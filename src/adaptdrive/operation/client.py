"""The operator's side of the MQTT contract: ask one drive, wait for its answer."""

from __future__ import annotations

import asyncio
import getpass
import json
import math
import os
import re
import socket
import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any, TypeVar

import msgspec
from aiomqtt import Client, MqttError, ProtocolVersion

from adaptdrive.config.services import Mqtt
from adaptdrive.errors import AdaptdriveError
from adaptdrive.operation.commands import LONGEST_USER, STOP
from adaptdrive.operation.link import connection
from adaptdrive.operation.messages import ONLINE, Reply
from adaptdrive.operation.simulator import DISTURB, REPLY, TRUTH, DeviceReply, simulator_topic
from adaptdrive.operation.topics import Topics

AnyReply = TypeVar("AnyReply", Reply, DeviceReply)
T = TypeVar("T")

SIMULATOR = "simulator"
"""Name under which `follow` yields the state of a simulated device."""

TELEMETRY_WAIT_S = 1.0
_SHORTEST_S = 1e-3  # paho takes no wait of 0
_DRIVE = re.compile("[A-Za-z0-9_-]{1,64}")
SITE_WAIT_S = 0.5
"""From the last message of a new drive: retained messages come at once, telemetry in 0.1 s."""


class NoAnswerError(AdaptdriveError):
    """A drive, or the broker in front of it, did not answer."""

    def __init__(self, drive: str, problem: str) -> None:
        self.drive = drive
        self.problem = problem
        super().__init__(f"{drive}: {problem}")


class _Timed(msgspec.Struct):
    time: Annotated[datetime, msgspec.Meta(tz=True)]


@dataclass(slots=True)
class DriveStatus:
    """State and telemetry of a drive; each part None until it is received.

    Attributes:
        availability: `online` or `offline`.
        state: Payload of `state`.
        telemetry: Payloads of `telemetry/load` and `telemetry/drive`, by their last part.
    """

    availability: str | None = None
    state: dict[str, Any] | None = None
    telemetry: dict[str, dict[str, Any]] = field(default_factory=dict)


async def send_command(
    broker: Mqtt, drive: str, verb: str, value: object, timeout_s: float, **fields: object
) -> Reply:
    """Send one command and wait for the reply to it; it expires when the wait ends.

    A `disable` never expires. Where the drive publishes telemetry, the time is by its clock.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        verb: What to do.
        value: Value of the command, None for verbs that take none.
        timeout_s: Longest wait for the broker and the reply.
        fields: Fields of the payload beside the value.

    Raises:
        NoAnswerError: No reply in time, or no broker.
    """
    topics = Topics(drive)
    places = topics.command(verb), topics.reply
    end_s = _end_s(timeout_s)
    async with _conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        command = {"value": value, "user": sender(), **fields}
        if verb != STOP:
            command = {"expires": await _expiry(client, topics, end_s)} | command
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
    end_s = _end_s(timeout_s)
    async with _conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        return await _ask(client, drive, places, request, DeviceReply)


def _end_s(timeout_s: float) -> float:
    """Return the end of a wait that begins now, by the clock of the event loop."""
    return asyncio.get_running_loop().time() + timeout_s


async def _expiry(client: Client, topics: Topics, end_s: float) -> str:
    """Return the time at which a wait ends, by the clock of the drive where it is heard."""
    now_s = asyncio.get_running_loop().time
    ahead_s = await _clock_difference_s(client, topics, (end_s - now_s()) / 2.0)
    return (datetime.now(UTC) + timedelta(seconds=end_s - now_s() + ahead_s)).isoformat()


async def _clock_difference_s(client: Client, topics: Topics, patience_s: float) -> float:
    """Return how far the clock of a drive is ahead, 0 where no telemetry comes.

    Telemetry that comes late makes a command expire early, and never late.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(min(patience_s, TELEMETRY_WAIT_S)):
            await client.subscribe(topics.drive_telemetry)
            async for message in client.messages:
                told = _decoded(bytes(message.payload), _Timed)
                if told is not None and not message.retain:
                    return (told.time - datetime.now(UTC)).total_seconds()
    return 0.0


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
    await client.publish(asked, json.dumps(content | {"id": identity}), qos=1)
    async for message in client.messages:
        if message.topic.value == answered:
            reply = _decoded(bytes(message.payload), kind)
            if reply is not None and reply.id == identity:
                return reply
    raise NoAnswerError(drive, "the broker closed the connection")


def sender() -> str:
    """Return the sender that a command names: user and machine, unverified."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user id without a name
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()}"[:LONGEST_USER]


async def read_status(broker: Mqtt, drive: str, timeout_s: float) -> DriveStatus:
    """Return the retained state of a drive, and its telemetry if some arrives in time.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the broker and the retained state.

    Raises:
        NoAnswerError: No state in time, or no broker.
    """
    topics, status, end_s = Topics(drive), DriveStatus(), _end_s(timeout_s)
    async with _conversation(broker, drive, end_s) as client:
        async with asyncio.timeout_at(end_s):
            await client.subscribe(topics.availability, qos=1)
            await client.subscribe(topics.state, qos=1)
            await _listen(client, topics, status, _complete)
        if status.availability == ONLINE.decode():
            await _add_telemetry(client, topics, status, end_s)
    return status


async def telemetry(broker: Mqtt, drive: str) -> AsyncGenerator[tuple[str, dict[str, Any]], None]:
    """Yield telemetry as it is published: `load` or `drive`, and the message.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics, status = Topics(drive), DriveStatus()
    async with _conversation(broker, drive) as client:
        await client.subscribe(topics.load_telemetry)
        await client.subscribe(topics.drive_telemetry)
        async for message in client.messages:
            status.telemetry.clear()
            _note(message.topic.value, bytes(message.payload), topics, status)
            for name, content in status.telemetry.items():
                yield name, content


async def read_site(broker: Mqtt, timeout_s: float) -> dict[str, DriveStatus]:
    """Return what the broker holds of all drives, and their telemetry if some arrives in time.

    Args:
        broker: Where the broker is.
        timeout_s: Longest time in all.

    Raises:
        NoAnswerError: No broker.
    """
    site: dict[str, DriveStatus] = {}
    end_s = _end_s(timeout_s)
    async with _conversation(broker, "all drives", end_s) as client:
        every = Topics("+")
        retained = (every.availability, every.state, every.load_telemetry)
        await client.subscribe([(topic, 1) for topic in (*retained, every.drive_telemetry)])
        with suppress(TimeoutError):
            async with asyncio.timeout_at(end_s), asyncio.timeout(SITE_WAIT_S) as quiet:
                await _listen_to_all(client, site, quiet)
    return {name: status for name, status in site.items() if status.availability or status.state}


async def _listen_to_all(
    client: Client, site: dict[str, DriveStatus], quiet: asyncio.Timeout
) -> None:
    """Note all messages; each drive that is new prolongs the wait."""
    async for message in client.messages:
        _, drive, *_ = message.topic.value.split("/")
        if _DRIVE.fullmatch(drive) is None:
            continue
        if drive not in site:
            quiet.reschedule(asyncio.get_running_loop().time() + SITE_WAIT_S)
        status = site.setdefault(drive, DriveStatus())
        _note(message.topic.value, bytes(message.payload), Topics(drive), status)


async def follow(broker: Mqtt, drive: str) -> AsyncIterator[tuple[str, dict[str, Any]]]:
    """Ask for the history of a drive, and yield all that it publishes, by the name of its topic.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics = Topics(drive)
    names = (topics.state, topics.load_telemetry, topics.drive_telemetry, topics.event)
    async with _conversation(broker, drive) as client:
        await client.subscribe([(name, 1) for name in (*names, topics.history)])
        await client.subscribe(topics.availability, qos=1)
        truth = simulator_topic(drive, TRUTH)
        await client.subscribe(truth)
        await client.publish(topics.ask_history, b"", qos=1)
        async for message in client.messages:
            name, payload = topics.name(message.topic.value), bytes(message.payload)
            if message.topic.value == truth:
                yield SIMULATOR, _content(payload) or {}
            elif name == "availability":
                yield name, {name: payload.decode("utf-8", "replace")}
            elif (content := _content(payload)) is not None:
                yield name, content


def printable(value: object) -> str:
    """Return a part of a payload as text without characters that command a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(value))


def _content(payload: bytes) -> dict[str, Any] | None:
    """Return a JSON object, None for anything else."""
    try:
        return msgspec.json.decode(payload, type=dict[str, Any])
    except msgspec.DecodeError:
        return None


def _complete(status: DriveStatus) -> bool:
    return status.state is not None and status.availability is not None


async def _add_telemetry(client: Client, topics: Topics, status: DriveStatus, end_s: float) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout_at(min(end_s, _end_s(TELEMETRY_WAIT_S))):
            await client.subscribe(topics.load_telemetry)
            await client.subscribe(topics.drive_telemetry)
            await _listen(client, topics, status, lambda status: len(status.telemetry) == 2)


async def _listen(
    client: Client, topics: Topics, status: DriveStatus, enough: Callable[[DriveStatus], bool]
) -> None:
    async for message in client.messages:
        _note(message.topic.value, bytes(message.payload), topics, status)
        if enough(status):
            return


def _note(topic: str, payload: bytes, topics: Topics, status: DriveStatus) -> None:
    if topic == topics.availability:
        status.availability = payload.decode("utf-8", "replace")
        return
    if (content := _content(payload)) is None:
        return
    if topic == topics.state:
        status.state = content
    else:
        status.telemetry[topic.rpartition("/")[2]] = content


def _decoded(payload: bytes, kind: type[T]) -> T | None:
    """Return what a payload holds, None where it is no JSON of that kind."""
    try:
        return msgspec.json.decode(payload, type=kind)
    except msgspec.DecodeError:
        return None


@asynccontextmanager
async def _conversation(broker: Mqtt, drive: str, end_s: float = math.inf) -> AsyncIterator[Client]:
    """Connect to a broker until a time of the event loop; what follows has limits of its own."""
    place = f"{broker.host}:{broker.port}"
    wait_s = max(_SHORTEST_S, end_s - asyncio.get_running_loop().time())
    try:
        async with (
            asyncio.timeout_at(end_s) as connecting,
            connection(broker, ProtocolVersion.V311, None, None, wait_s) as client,
        ):
            connecting.reschedule(None)
            yield client
    except TimeoutError as problem:
        _pass_on_cancellation(problem)
        silence = f"no answer by way of {place}; see `adaptdrive list`"
        if connecting.expired():
            silence = f"no answer from broker {place} within {wait_s:.3g} s"
        raise NoAnswerError(drive, silence) from problem
    except (MqttError, OSError) as problem:
        _pass_on_cancellation(problem)
        raise NoAnswerError(drive, f"broker {place}: {problem}") from problem


def _pass_on_cancellation(problem: Exception) -> None:
    """A client that fails while it is being cancelled hides the cancellation; bring it back."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError from problem
