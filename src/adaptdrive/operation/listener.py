"""Reading of what drives publish: state and telemetry of one or all, once or as it comes."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from aiomqtt import Client, Message

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import conversation, end_of, json_object
from adaptdrive.operation.messages import ONLINE, TRUTH, Topics, simulator_topic

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
        return self.availability == ONLINE.decode()

    @property
    def silent(self) -> bool:
        """True if the daemon is online by the broker's word only."""
        return self.online and not self.live


async def read_status(broker: Mqtt, drive: str, timeout_s: float) -> DriveStatus:
    """Return the retained state of a drive, and its telemetry if some arrives in time.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.
        timeout_s: Longest wait for the broker and the retained state.

    Raises:
        NoAnswerError: No state in time, or no broker.
    """
    topics, status, end_s = Topics(drive), DriveStatus(), end_of(timeout_s)
    async with conversation(broker, drive, end_s) as client:
        async with asyncio.timeout_at(end_s):
            await client.subscribe([(topics.availability, 1), (topics.state, 1)])
            await _listen(client, {drive: status}, lambda: _complete(status))
        if status.online:
            with suppress(TimeoutError):
                async with asyncio.timeout_at(min(end_s, end_of(LIFE_WAIT_S))):
                    await client.subscribe(_telemetry_of(topics))
                    await _listen(client, {drive: status}, lambda: _alive(status))
    return status


async def telemetry(broker: Mqtt, drive: str) -> AsyncGenerator[tuple[str, dict[str, Any]], None]:
    """Yield telemetry as it is published: `load` or `drive`, and the message.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics = Topics(drive)
    async with conversation(broker, drive) as client:
        await client.subscribe(_telemetry_of(topics))
        async for message in client.messages:
            content = json_object(bytes(message.payload))
            # what the broker has kept is of an earlier time
            if content is not None and not message.retain:
                yield message.topic.value.rpartition("/")[2], content


async def read_site(broker: Mqtt, timeout_s: float) -> dict[str, DriveStatus]:
    """Return what the broker holds of all drives, and their telemetry if some arrives in time.

    Args:
        broker: Where the broker is.
        timeout_s: Longest time in all.

    Raises:
        NoAnswerError: No broker.
    """
    site: dict[str, DriveStatus] = {}
    end_s = end_of(timeout_s)
    async with conversation(broker, "all drives", end_s) as client:
        every = Topics("+")
        retained = (every.availability, every.state, every.load_telemetry)
        async with asyncio.timeout_at(end_s):
            await client.subscribe([(topic, 1) for topic in (*retained, every.drive_telemetry)])
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


async def follow(broker: Mqtt, drive: str) -> AsyncGenerator[tuple[str, dict[str, Any]], None]:
    """Ask for the history of a drive, and yield all that it publishes, by the name of its topic.

    Args:
        broker: Where the broker is.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The broker cannot be reached, or closed the connection.
    """
    topics = Topics(drive)
    names = (topics.state, topics.load_telemetry, topics.drive_telemetry, topics.event)
    async with conversation(broker, drive) as client:
        await client.subscribe([(name, 1) for name in (*names, topics.history)])
        await client.subscribe(topics.availability, qos=1)
        truth = simulator_topic(drive, TRUTH)
        await client.subscribe(truth)
        await client.publish(topics.ask_history, b"", qos=1)
        async for message in client.messages:
            name, payload = topics.name(message.topic.value), bytes(message.payload)
            if message.retain and message.topic.value == topics.drive_telemetry:
                continue  # kept by the broker, of an earlier time
            if message.topic.value == truth:
                yield SIMULATOR, json_object(payload) or {}
            elif name == "availability":
                yield name, {name: payload.decode("utf-8", "replace")}
            elif (content := json_object(payload)) is not None:
                yield name, content


def _telemetry_of(topics: Topics) -> list[tuple[str, int]]:
    return [(topics.load_telemetry, 0), (topics.drive_telemetry, 0)]


def _complete(status: DriveStatus) -> bool:
    return status.state is not None and status.availability is not None


def _alive(status: DriveStatus) -> bool:
    return status.live and "drive" in status.telemetry


async def _listen(client: Client, site: dict[str, DriveStatus], enough: Callable[[], bool]) -> None:
    async for message in client.messages:
        _note(message, site)
        if enough():
            return


def _note(message: Message, site: dict[str, DriveStatus]) -> None:
    topic, payload = message.topic.value, bytes(message.payload)
    _, drive, *_ = topic.split("/")
    if _DRIVE.fullmatch(drive) is None:
        return
    topics, status = Topics(drive), site.setdefault(drive, DriveStatus())
    if topic == topics.availability:
        status.availability = payload.decode("utf-8", "replace")
    elif (content := json_object(payload)) is None:
        return
    elif topic == topics.state:
        status.state = content
    else:
        status.telemetry[topic.rpartition("/")[2]] = content
        status.live = status.live or not message.retain
