"""What the operator's side of the contract sends, heard by another client of a real broker."""

from __future__ import annotations

import asyncio
import json
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from aiomqtt import Client

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import read_site, read_status
from adaptdrive.operation.sender import send_command
from adaptdrive.operation.steady import SteadyClient
from tests.support import Broker

TIMEOUT_S = 4.0
PATIENCE_S = 60.0


@asynccontextmanager
async def mute_drive(broker: Broker, drive: str) -> AsyncIterator[asyncio.Queue[dict[str, Any]]]:
    """A drive that answers nothing; what it is asked comes into a queue."""
    heard: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
    async with Client(broker.host, broker.port) as client, asyncio.TaskGroup() as tasks:
        await client.subscribe(f"adaptdrive/{drive}/command/#")

        async def listen() -> None:
            async for message in client.messages:
                heard.put_nowait(json.loads(bytes(message.payload)))

        listening = tasks.create_task(listen())
        yield heard
        listening.cancel()


async def ask(broker: Broker, drive: str, verb: str) -> tuple[dict[str, Any], datetime]:
    """What a drive hears of a command, and when its sender gave it up."""
    settings = Mqtt(host=broker.host, port=broker.port)
    async with asyncio.timeout(PATIENCE_S), mute_drive(broker, drive) as heard:
        with pytest.raises(NoAnswerError):
            await send_command(settings, drive, verb, None, TIMEOUT_S)
        return await heard.get(), datetime.now(UTC)


async def test_a_command_expires_before_its_sender_gives_it_up(mosquitto: Broker) -> None:
    command, given_up = await ask(mosquitto, f"mute-{uuid.uuid4()}", "enable")
    expires = datetime.fromisoformat(command["expires"])
    assert given_up - timedelta(seconds=TIMEOUT_S) < expires <= given_up


async def test_a_disable_never_expires(mosquitto: Broker) -> None:
    command, _ = await ask(mosquitto, f"mute-{uuid.uuid4()}", "disable")
    assert "expires" not in command


async def test_a_value_may_be_a_number_of_numpy(mosquitto: Broker) -> None:
    drive = f"mute-{uuid.uuid4()}"
    settings = Mqtt(host=mosquitto.host, port=mosquitto.port)
    async with asyncio.timeout(PATIENCE_S), mute_drive(mosquitto, drive) as heard:
        volts, hold_s = np.float32(280.5), np.int64(5)
        with pytest.raises(NoAnswerError):
            await send_command(settings, drive, "voltage", volts, TIMEOUT_S, hold_s=hold_s)
        command = await heard.get()
    assert (command["value"], command["hold_s"]) == (280.5, 5)


@asynccontextmanager
async def silent_broker() -> AsyncIterator[Mqtt]:
    """A broker that accepts connections and never says a word."""
    ended = asyncio.Event()

    async def hold(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await ended.wait()
        writer.close()

    async with await asyncio.start_server(hold, "127.0.0.1") as server:
        yield Mqtt(host="127.0.0.1", port=server.sockets[0].getsockname()[1])
        ended.set()


async def test_a_time_out_bounds_the_connection_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adaptdrive.operation.link.TIMEOUT_S", PATIENCE_S)
    async with asyncio.timeout(PATIENCE_S / 2.0), silent_broker() as broker:
        silence = f"no answer from broker {broker.host}:{broker.port} within 0.2 s"
        for wait in (
            send_command(broker, "mute", "disable", None, 0.2),
            read_status(broker, "mute", 0.2),
            read_site(broker, 0.2),
        ):
            with pytest.raises(NoAnswerError, match=silence):
                await wait


@pytest.mark.parametrize("ahead_s", [-1.8e9, -3600.0, 3600.0])
async def test_the_time_of_the_end_is_by_the_clock_of_the_drive(
    mosquitto: Broker, ahead_s: float
) -> None:
    drive, ahead = f"mute-{uuid.uuid4()}", timedelta(seconds=ahead_s)

    async def tell() -> None:
        async with SteadyClient(mosquitto.host, mosquitto.port) as client:
            while True:
                time = (datetime.now(UTC) + ahead).isoformat()
                topic = f"adaptdrive/{drive}/telemetry/drive"
                await client.publish(topic, json.dumps({"time": time}))
                await asyncio.sleep(0.02)

    telling = asyncio.create_task(tell())
    try:
        command, given_up = await ask(mosquitto, drive, "enable")
    finally:
        telling.cancel()
        await asyncio.wait([telling])
    expires = datetime.fromisoformat(command["expires"]) - ahead
    assert given_up - timedelta(seconds=TIMEOUT_S) < expires <= given_up
