"""An operator's side of the contract: reading of what drives publish, sending of commands."""

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
from aiomqtt import Client, Message, MqttError, ProtocolVersion

from adaptdrive.mqtt import commands, contract
from adaptdrive.mqtt.connection import Broker, connection
from adaptdrive.util.errors import NOT_JSON, PlacedError
from adaptdrive.util.quantity import Display

# A conversation of an operator with one drive: the connection, its errors, the payloads.

T = TypeVar("T")

TELEMETRY_WAIT_S = 1.5
"""Longest wait for telemetry, which comes at least once a second where a drive publishes."""

_SHORTEST_S = 1e-3  # paho takes no wait of 0


class NoAnswerError(PlacedError):
    """A drive, or the broker in front of it, did not answer."""


def end_of(timeout_s: float) -> float:
    """Return the end of a wait that begins now, by the clock of the event loop."""
    return asyncio.get_running_loop().time() + timeout_s


@asynccontextmanager
async def conversation(
    broker: Broker, drive: str, end_s: float = math.inf
) -> AsyncIterator[Client]:
    """Connect to a broker until a time of the event loop; what follows has its own limits."""
    place = f"{broker.host}:{broker.port}"
    wait_s = max(_SHORTEST_S, end_s - asyncio.get_running_loop().time())
    try:
        async with (
            asyncio.timeout_at(end_s) as connecting,
            connection(broker, ProtocolVersion.V311, timeout_s=wait_s) as client,
        ):
            connecting.reschedule(None)
            yield client
    except TimeoutError as problem:
        _pass_on_cancellation(problem)
        silence = f"no answer through {place}; see `adaptdrive list`"
        if connecting.expired():
            silence = f"no answer from broker {place} within {wait_s:.3g} s"
        raise NoAnswerError(drive, silence) from problem
    except (MqttError, OSError) as problem:
        _pass_on_cancellation(problem)
        raise NoAnswerError(drive, f"broker {place}: {problem}") from problem


def decoded(payload: bytes, kind: type[T]) -> T | None:
    """Return what a payload holds, None where it is no JSON of that kind."""
    try:
        return msgspec.json.decode(payload, type=kind)
    except NOT_JSON:
        return None


def _pass_on_cancellation(problem: Exception) -> None:
    """A client that fails while it is being cancelled hides the cancellation; bring it back."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError from problem


# Reading of what drives publish: state and telemetry of one or all, once or as it comes.

SIMULATOR = "simulator"
"""Name under which `follow` yields the state of a simulated device."""

_DRIVE = re.compile("[A-Za-z0-9_-]{1,64}")
SITE_WAIT_S = 0.5
"""From the last message of a new drive: retained messages come at once, telemetry in 0.1 s."""

LIFE_WAIT_S = 3.0
"""Longest wait for telemetry of a drive that is online: it comes at least once a second."""

LIVE_S = 3.0
"""Longest age of a measurement that is shown as live."""


@dataclass(slots=True)
class DriveStatus:
    """State and telemetry of a drive; each part None until it is received.

    Attributes:
        availability: `online` or `offline`.
        state: Payload of `state`.
        telemetry: Payloads of `telemetry/load` and `telemetry/drive`, by their last part.
        live: Whether telemetry came that the broker had not kept from an earlier time.
    """

    availability: str | None = None
    state: dict[str, Any] | None = None
    telemetry: dict[str, dict[str, Any]] = field(default_factory=dict)
    live: bool = False

    @property
    def online(self) -> bool:
        """True if the broker says that the daemon is there; it can have kept that, too."""
        return self.availability == contract.ONLINE.decode()

    @property
    def silent(self) -> bool:
        """True if the daemon is online by the broker's report only."""
        return self.online and not self.live


async def read_status(broker: Broker, drive: str, timeout_s: float) -> DriveStatus:
    """Return the retained state of a drive, and its telemetry if some arrives in time.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the broker and the retained state.

    Raises:
        NoAnswerError: No state in time, or no broker.
    """
    topics, status, end_s = contract.Topics(drive), DriveStatus(), end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client:
        async with asyncio.timeout_at(end_s):
            await client.subscribe([(topics.availability, 1), (topics.state, 1)])
            await _listen(
                client,
                {drive: status},
                lambda: status.state is not None and status.availability is not None,
            )
        if status.online:
            with suppress(TimeoutError):
                async with asyncio.timeout_at(min(end_s, end_of(LIFE_WAIT_S))):
                    await client.subscribe(_telemetry_of(topics))
                    await _listen(
                        client, {drive: status}, lambda: status.live and "drive" in status.telemetry
                    )
    return status


async def read_display(broker: Broker, drive: str, timeout_s: float) -> Display:
    """Return the unit in which people type the output; arguments and errors as of `read_status`."""
    status, end_s = DriveStatus(), end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        await client.subscribe(contract.Topics(drive).state, qos=1)
        await _listen(client, {drive: status}, lambda: status.state is not None)
    return commands.display_in(status.state or {})


async def telemetry(broker: Broker, drive: str) -> AsyncGenerator[tuple[str, dict[str, Any]], None]:
    """Yield telemetry as it is published: `load` or `drive`, and the message.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics = contract.Topics(drive)
    async with conversation(broker, drive) as client:
        await client.subscribe(_telemetry_of(topics))
        async for message in client.messages:
            _, name, content = _read(message)
            # what the broker has kept is of an earlier time
            if content is not None and not message.retain:
                yield name.rpartition("/")[2], content


async def read_site(broker: Broker, timeout_s: float) -> dict[str, DriveStatus]:
    """Return what the broker holds of all drives, and their telemetry if some arrives in time.

    Raises:
        NoAnswerError: No broker.
    """
    site: dict[str, DriveStatus] = {}
    end_s = end_of(timeout_s)
    async with conversation(broker, "all drives", end_s) as client:
        every = contract.Topics("+")
        topics = every.availability, every.state, every.load_telemetry, every.drive_telemetry
        async with asyncio.timeout_at(end_s):
            await client.subscribe([(topic, 1) for topic in topics])
        life_s = end_of(LIFE_WAIT_S)
        with suppress(TimeoutError):
            async with asyncio.timeout_at(end_s), asyncio.timeout(SITE_WAIT_S) as quiet:
                await _listen_to_all(client, site, quiet)
        with suppress(TimeoutError):
            async with asyncio.timeout_at(min(end_s, life_s)):
                if any(status.silent for status in site.values()):
                    await _listen(client, site, lambda: not any(s.silent for s in site.values()))
    return {name: status for name, status in site.items() if status.availability or status.state}


async def _listen_to_all(
    client: Client, site: dict[str, DriveStatus], quiet: asyncio.Timeout
) -> None:
    """Note all messages; each drive that is new prolongs the wait."""
    async for message in client.messages:
        known = len(site)
        _note(message, site)
        if len(site) > known:
            quiet.reschedule(asyncio.get_running_loop().time() + SITE_WAIT_S)


async def follow(broker: Broker, drive: str) -> AsyncGenerator[tuple[str, dict[str, Any]], None]:
    """Ask for the history of a drive, and yield all that it publishes, by the name of its topic.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics = contract.Topics(drive)
    names = (topics.state, topics.load_telemetry, topics.drive_telemetry, topics.event)
    async with conversation(broker, drive) as client:
        await client.subscribe([(name, 1) for name in (*names, topics.history)])
        await client.subscribe(topics.availability, qos=1)
        await client.subscribe(contract.simulator_topic(drive, contract.TRUTH))
        await client.publish(topics.ask_history, b"", qos=1)
        async for message in client.messages:
            _, name, content = _read(message)
            if name == contract.TRUTH:
                yield SIMULATOR, content or {}
            # telemetry that the broker has kept is of an earlier time
            elif content is not None and not (message.retain and name == "telemetry/drive"):
                yield name, content


def _telemetry_of(topics: contract.Topics) -> list[tuple[str, int]]:
    return [(topics.load_telemetry, 0), (topics.drive_telemetry, 0)]


async def _listen(client: Client, site: dict[str, DriveStatus], enough: Callable[[], bool]) -> None:
    async for message in client.messages:
        _note(message, site)
        if enough():
            return


def _note(message: Message, site: dict[str, DriveStatus]) -> None:
    drive, name, content = _read(message)
    if content is None or _DRIVE.fullmatch(drive) is None:
        return
    status = site.setdefault(drive, DriveStatus())
    if name == "availability":
        status.availability = content[name]
    elif name == "state":
        status.state = content
    else:
        status.telemetry[name.rpartition("/")[2]] = content
        status.live = status.live or not message.retain


def _read(message: Message) -> tuple[str, str, dict[str, Any] | None]:
    """Return the drive of a message, its topic below that, and what it holds if that is JSON."""
    _, drive, name = message.topic.value.split("/", 2)
    payload = bytes(message.payload)
    if name == "availability":
        return drive, name, {name: payload.decode("utf-8", "replace")}
    return drive, name, decoded(payload, dict[str, Any])


# Operators' commands and disturbances: sent to one drive, and its reply.

AnyReply = TypeVar("AnyReply", contract.Reply, contract.DeviceReply)

_FARTHEST_S = 3e9
"""Difference of a clock, 95 years, from which on it says nothing; one may have begun in 1970."""


class _Timed(msgspec.Struct):
    time: Annotated[datetime, msgspec.Meta(tz=True)]


async def send_command(
    broker: Broker, drive: str, verb: str, value: object, timeout_s: float, **fields: object
) -> contract.Reply:
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
    topics = contract.Topics(drive)
    places = topics.command(verb), topics.reply
    end_s = end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        command = {"value": value, "user": _sender(), **fields}
        if verb != commands.STOP:
            command = {"expires": await _expiry(client, drive, topics, end_s)} | command
        return await _ask(client, drive, places, command, contract.Reply)


async def disturb(
    broker: Broker, drive: str, request: dict[str, Any], timeout_s: float
) -> contract.DeviceReply:
    """Ask a simulated device for a disturbance and wait for its answer.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        request: Disturbance that the device offers.
        timeout_s: Longest wait for the broker and the answer.

    Raises:
        NoAnswerError: No answer in time, or no broker.
    """
    places = (
        contract.simulator_topic(drive, contract.DISTURB),
        contract.simulator_topic(drive, contract.REPLY),
    )
    end_s = end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client, asyncio.timeout_at(end_s):
        return await _ask(client, drive, places, request, contract.DeviceReply)


async def _expiry(client: Client, drive: str, topics: contract.Topics, end_s: float) -> str:
    """Return the time at which a wait ends, by the clock of the drive where it publishes."""
    patience_s = (end_s - asyncio.get_running_loop().time()) / 2.0
    ahead_s = await _clock_difference_s(client, topics, patience_s)
    if ahead_s is None:
        places = topics.command(commands.PING), topics.reply
        await _ask(client, drive, places, {"expires": _moment(end_s)}, contract.Reply)
    return _moment(end_s, ahead_s or 0.0)


def _moment(end_s: float, ahead_s: float = 0.0) -> str:
    """Return a time of the event loop by a clock that is ahead of that of this machine."""
    left_s = end_s - asyncio.get_running_loop().time()
    return (datetime.now(UTC) + timedelta(seconds=left_s + ahead_s)).isoformat()


async def _clock_difference_s(
    client: Client, topics: contract.Topics, patience_s: float
) -> float | None:
    """Return how far the clock of a drive is ahead, None where no telemetry comes.

    Telemetry that comes late makes a command expire early, and never late.
    """
    with suppress(TimeoutError):
        async with asyncio.timeout(min(patience_s, TELEMETRY_WAIT_S)):
            await client.subscribe(topics.drive_telemetry)
            async for message in client.messages:
                found = decoded(bytes(message.payload), _Timed)
                if found is not None and not message.retain:
                    ahead_s = (found.time - datetime.now(UTC)).total_seconds()
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
    return f"{user}@{socket.gethostname()}"[: commands.LONGEST_USER]
