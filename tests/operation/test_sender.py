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


Heard = asyncio.Queue[tuple[str, dict[str, Any]]]


@asynccontextmanager
async def commands(broker: Broker, drive: str) -> AsyncIterator[Heard]:
    """What a drive is asked: each verb and its payload come into a queue."""
    heard: Heard = asyncio.Queue()
    async with Client(broker.host, broker.port) as client, asyncio.TaskGroup() as tasks:
        await client.subscribe(f"adaptdrive/{drive}/command/#")

        async def listen() -> None:
            async for message in client.messages:
                verb = message.topic.value.rpartition("/")[2]
                heard.put_nowait((verb, json.loads(bytes(message.payload))))

        listening = tasks.create_task(listen())
        yield heard
        listening.cancel()


@asynccontextmanager
async def mute_drive(broker: Broker, drive: str, ahead: timedelta) -> AsyncIterator[Heard]:
    """A drive that publishes telemetry and answers nothing."""

    async def publish() -> None:
        async with SteadyClient(broker.host, broker.port) as client:
            while True:
                time = (datetime.now(UTC) + ahead).isoformat()
                topic = f"adaptdrive/{drive}/telemetry/drive"
                await client.publish(topic, json.dumps({"time": time}))
                await asyncio.sleep(0.02)

    async with commands(broker, drive) as heard:
        publishing = asyncio.create_task(publish())
        try:
            yield heard
        finally:
            publishing.cancel()
            await asyncio.wait([publishing])


async def ask(
    broker: Broker, drive: str, verb: str, ahead: timedelta = timedelta()
) -> tuple[dict[str, Any], datetime]:
    """What a drive hears of a command, and when its sender gave it up."""
    settings = Mqtt(host=broker.host, port=broker.port)
    async with asyncio.timeout(PATIENCE_S), mute_drive(broker, drive, ahead) as heard:
        with pytest.raises(NoAnswerError):
            await send_command(settings, drive, verb, None, TIMEOUT_S)
        return (await heard.get())[1], datetime.now(UTC)


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
    async with asyncio.timeout(PATIENCE_S), mute_drive(mosquitto, drive, timedelta()) as heard:
        volts, hold_s = np.float32(280.5), np.int64(5)
        with pytest.raises(NoAnswerError):
            await send_command(settings, drive, "voltage", volts, TIMEOUT_S, hold_s=hold_s)
        _, command = await heard.get()
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
    command, given_up = await ask(mosquitto, drive, "enable", ahead)
    expires = datetime.fromisoformat(command["expires"]) - ahead
    assert given_up - timedelta(seconds=TIMEOUT_S) < expires <= given_up


async def test_nothing_but_a_stop_is_sent_to_a_drive_that_is_not_heard(mosquitto: Broker) -> None:
    drive, settings = f"mute-{uuid.uuid4()}", Mqtt(host=mosquitto.host, port=mosquitto.port)
    async with asyncio.timeout(PATIENCE_S), commands(mosquitto, drive) as heard:
        for verb in ("enable", "setpoint", "disable"):
            with pytest.raises(NoAnswerError):
                await send_command(settings, drive, verb, None, TIMEOUT_S)
        verbs = [heard.get_nowait()[0] for _ in range(heard.qsize())]
    assert verbs == ["ping", "ping", "disable"]


async def test_a_drive_without_telemetry_that_answers_is_commanded(mosquitto: Broker) -> None:
    drive, settings = f"dumb-{uuid.uuid4()}", Mqtt(host=mosquitto.host, port=mosquitto.port)
    async with asyncio.timeout(PATIENCE_S), commands(mosquitto, drive) as heard:
        asking = asyncio.create_task(send_command(settings, drive, "enable", None, TIMEOUT_S))
        async with Client(mosquitto.host, mosquitto.port) as client:
            for verb in ("ping", "enable"):
                asked, content = await heard.get()
                assert asked == verb
                reply = {
                    "id": content["id"],
                    "verb": verb,
                    "accepted": True,
                    "reason": "",
                    "state": "standby",
                }
                await client.publish(f"adaptdrive/{drive}/reply", json.dumps(reply))
        assert (await asking).verb == "enable"
