"""A `disable` acts whatever its payload says, ahead of all that waits, and is examined later."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from adaptdrive.mqtt.session import COMMANDS_HELD
from adaptdrive.runtime.requests import Disable, SetMode, SetSetpoint
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import Bench, RememberingHost, ask, listening, publish, serving

MORE = COMMANDS_HELD + 50


@pytest.mark.parametrize(
    "payload",
    ["", "{}", "OFF", "0", "[]", b"\xff\x00\xfe", '{"id": null}', "{" * 9000, b"\x00" * 100_000],
)
async def test_a_stop_without_an_id_acts(bench: Bench, payload: str | bytes) -> None:
    reply = await ask(bench, "disable", payload)
    assert (reply["id"], reply["accepted"]) == (None, True)
    assert bench.host.asked == [Disable()]


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("payload", ["OFF", '{"id": "a"}'])
async def test_a_retained_stop_acts_once_and_is_deleted(
    broker: MemoryBroker, tmp_path: Path, payload: str, *, live: bool
) -> None:
    topic = "adaptdrive/kept/command/disable"
    if not live:
        await publish(broker, topic, payload, "-r")
    async with (
        listening(broker, "adaptdrive/kept/event") as ear,
        serving(broker, "kept", tmp_path) as bench,
    ):
        if live:
            await publish(broker, topic, payload, "-r")
        event = await ear.on(bench.topic("event"))
        assert (event.content["kind"], event.content["severity"]) == ("command", "warning")
        assert "a retained disable" in event.content["detail"]
        await ask(bench, "setpoint", '{"id": "later", "value": 1}')
        assert bench.host.asked == [Disable(), SetSetpoint(1.0)]
        assert topic not in broker.retained


async def test_an_operator_who_deletes_a_retained_stop_stops(bench: Bench) -> None:
    await publish(bench.broker, bench.topic("command/disable"), "", "-r")
    assert bench.host.asked == [Disable()]


async def test_a_stop_acts_ahead_of_a_flood_which_costs_its_oldest_commands(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    """The commands before it are refused, and those after it are carried out."""
    gate = asyncio.Event()
    host = RememberingHost(gate=gate)
    async with (
        serving(broker, "flooded", tmp_path, host) as bench,
        listening(broker, bench.topic("reply")) as ear,
    ):
        topic = bench.topic("command")
        await publish(broker, f"{topic}/mode", '{"id": "first", "value": "fixed"}')
        await host.busy.wait()
        for number in range(MORE):
            payload = json.dumps({"id": f"before-{number}", "value": 1.0})
            await publish(broker, f"{topic}/setpoint", payload)
        await publish(broker, f"{topic}/disable", '{"id": "stop"}')
        assert [type(request) for request in host.asked] == [SetMode, Disable]
        stop = await ear.on(bench.topic("reply"))
        assert (stop.content["id"], stop.content["accepted"]) == ("stop", True)
        gate.set()
        await publish(broker, f"{topic}/setpoint", '{"id": "after", "value": 2}')
        last = await ear.until(lambda reply: reply.content["id"] == "after")
    assert last.content["accepted"]
    refused = {one.content["id"]: one.content["reason"] for one in ear.heard[2:-1]}
    assert list(refused) == [f"before-{number}" for number in range(51, MORE)]
    assert all("a disable arrived after this command" in reason for reason in refused.values())
    assert [type(request) for request in host.asked] == [SetMode, Disable, SetSetpoint]


async def test_a_flood_of_stops_is_carried_out_whole(bench: Bench) -> None:
    for _ in range(MORE):
        await publish(bench.broker, bench.topic("command/disable"), "x")
    assert bench.host.asked == [Disable()] * MORE
