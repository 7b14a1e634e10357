"""What the operator's side of the contract sends, and how long it waits, in virtual time."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta, tzinfo
from typing import Any

import numpy as np
import pytest
from aiomqtt import Message

from adaptdrive.mqtt.client import (
    NoAnswerError,
    _Timed,
    decoded,
    disturb,
    read_site,
    read_status,
    send_command,
)
from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import DISTURB, REPLY, simulator_topic
from tests.unit.mqtt.memory_broker import MemoryBroker, MemoryClient

TIMEOUT_S = 4.0
START = datetime(2026, 1, 1, tzinfo=UTC)
Heard = list[tuple[str, dict[str, Any]]]


class VirtualClock(datetime):
    """The clock of the sender's machine, which goes with the event loop."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]  # noqa: ARG003
        return START + timedelta(seconds=asyncio.get_running_loop().time())


decoded(b"{}", _Timed)  # its types are those of the real clock


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adaptdrive.mqtt.client.datetime", VirtualClock)


@asynccontextmanager
async def drive(
    broker: MemoryBroker, ahead_s: float | None = 0.0, *, answers: bool = False
) -> AsyncIterator[Heard]:
    """A drive whose clock is ahead, None for one without telemetry; what it is asked."""
    heard: Heard = []
    client = MemoryClient(broker)

    def hear(message: Message) -> None:
        verb, content = message.topic.value.rpartition("/")[2], json.loads(bytes(message.payload))
        heard.append((verb, content))
        if answers:
            reply = {"id": content["id"], "verb": verb, "accepted": True, "reason": ""}
            for other in (b"{", json.dumps(reply | {"id": "foreign", "state": None}).encode()):
                broker.publish("adaptdrive/motor/reply", other)
            body = json.dumps(reply | {"state": "standby"})
            broker.publish("adaptdrive/motor/reply", body.encode())

    async def talk() -> None:
        while ahead_s is not None:
            time = VirtualClock.now() + timedelta(seconds=ahead_s)
            body = json.dumps({"time": time.isoformat()})
            await client.publish("adaptdrive/motor/telemetry/drive", body)
            await asyncio.sleep(0.5)

    client.receive = hear
    async with client:
        await client.subscribe("adaptdrive/motor/command/#")
        talking = asyncio.create_task(talk())
        yield heard
        talking.cancel()
        await asyncio.wait([talking])


async def send(verb: str, value: object = None, **fields: object) -> None:
    """Send a command to a drive that answers nothing."""
    with pytest.raises(NoAnswerError, match=r"no answer through 127\.0\.0\.1:1883; see `adap"):
        await send_command(Broker(host="127.0.0.1"), "motor", verb, value, TIMEOUT_S, **fields)


@pytest.mark.parametrize("ahead_s", [0.0, -1.8e9, -3600.0, 3600.0, 3.0e9 - 1e6])
async def test_a_command_expires_before_its_sender_gives_it_up(
    broker: MemoryBroker, ahead_s: float
) -> None:
    """By the clock of the drive."""
    async with drive(broker, ahead_s) as heard:
        await send("enable")
        given_up = VirtualClock.now() + timedelta(seconds=ahead_s)
    ((verb, command),) = heard
    expires = datetime.fromisoformat(command["expires"])
    assert verb == "enable"
    assert abs(given_up - expires) < timedelta(milliseconds=1)


async def test_a_clock_that_says_nothing_is_taken_for_the_senders_own(broker: MemoryBroker) -> None:
    async with drive(broker, 3.1e9) as heard:
        await send("enable")
        given_up = VirtualClock.now()
    expires = datetime.fromisoformat(heard[0][1]["expires"])
    assert abs(given_up - expires) < timedelta(milliseconds=1)


async def test_a_disable_never_expires(broker: MemoryBroker) -> None:
    async with drive(broker) as heard:
        await send("disable")
    assert "expires" not in heard[0][1]


async def test_a_value_may_be_a_number_of_numpy(broker: MemoryBroker) -> None:
    async with drive(broker) as heard:
        await send("voltage", np.float32(280.5), hold_s=np.int64(5))
    ((_, command),) = heard
    assert (command["value"], command["hold_s"]) == (280.5, 5)
    assert "@" in command["user"]


async def test_nothing_but_a_stop_is_sent_to_a_drive_that_is_not_heard(
    broker: MemoryBroker,
) -> None:
    async with drive(broker, None) as heard:
        for verb in ("enable", "setpoint", "disable"):
            await send(verb)
    assert [verb for verb, _ in heard] == ["ping", "ping", "disable"]


async def test_telemetry_of_an_earlier_time_says_nothing_of_a_clock(broker: MemoryBroker) -> None:
    old = json.dumps({"time": (START - timedelta(days=9)).isoformat()}).encode()
    broker.publish("adaptdrive/motor/telemetry/drive", old, retain=True)
    async with drive(broker, None, answers=True) as heard:
        reply = await send_command(Broker(), "motor", "enable", None, TIMEOUT_S)
    assert (reply.verb, reply.accepted) == ("enable", True)
    assert [verb for verb, _ in heard] == ["ping", "enable"]


async def test_the_answer_of_a_device_is_its_own(broker: MemoryBroker) -> None:
    client = MemoryClient(broker)

    def answer(message: Message) -> None:
        identity = json.loads(bytes(message.payload))["id"]
        body = json.dumps({"id": identity, "accepted": True, "reason": ""})
        broker.publish(simulator_topic("motor", REPLY), body.encode())

    client.receive = answer
    async with client:
        await client.subscribe(simulator_topic("motor", DISTURB))
        assert (await disturb(Broker(), "motor", {"kind": "load"}, TIMEOUT_S)).accepted


async def test_a_time_out_bounds_the_connection_too(broker: MemoryBroker) -> None:
    broker.hangs = True
    place, began_s = Broker(host="127.0.0.1"), asyncio.get_running_loop().time()
    for wait in (
        send_command(place, "mute", "disable", None, 0.2),
        read_status(place, "mute", 0.2),
        read_site(place, 0.2),
    ):
        with pytest.raises(
            NoAnswerError, match=r"1883 within 0\.2 s$|1883: no answer from the broker$"
        ):
            await wait
    assert asyncio.get_running_loop().time() - began_s == pytest.approx(0.6)


async def test_a_broker_that_ends_the_connection_is_named(broker: MemoryBroker) -> None:
    broker.away = True
    with pytest.raises(NoAnswerError, match=r"broker 127\.0\.0\.1:1883: connection refused"):
        await send_command(Broker(host="127.0.0.1"), "motor", "enable", None, TIMEOUT_S)
