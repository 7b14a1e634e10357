"""More commands than can be answered: memory stays bounded, and a stop is never lost."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

from aiomqtt import Message

from adaptdrive.operation.link import LARGEST_BACKLOG
from adaptdrive.operation.session import COMMANDS_HELD
from adaptdrive.operation.waiting import NewestMessages
from adaptdrive.runtime.requests import Disable, SetSetpoint
from tests.operation.peers import RememberingHost, publish, publish_lines, serving
from tests.support import Broker

HALF = LARGEST_BACKLOG + COMMANDS_HELD + 50


def message(verb: str, number: int) -> Message:
    topic = f"adaptdrive/motor/command/{verb}"
    return Message(topic, b"", qos=1, retain=False, mid=number, properties=None)


async def test_a_full_queue_loses_its_oldest_and_counts_but_keeps_a_stop() -> None:
    queue = NewestMessages(4)
    for number, verb in enumerate(("setpoint", "disable", *["setpoint"] * 8)):
        queue.put_nowait(message(verb, number))
    assert [queue.get_nowait().mid for _ in range(4)] == [1, 7, 8, 9]
    assert queue.dropped == 6
    assert queue.empty()


async def test_a_queue_full_of_stops_loses_the_oldest_of_them() -> None:
    queue = NewestMessages(2)
    for number in range(3):
        queue.put_nowait(message("disable", number))
    assert [queue.get_nowait().mid for _ in range(2)] == [1, 2]


async def test_a_flood_of_commands_costs_the_oldest_and_never_a_stop(
    mosquitto: Broker, tmp_path: Path
) -> None:
    host = RememberingHost(gate=asyncio.Event())
    async with serving(mosquitto, "flooded", tmp_path, host) as bench:
        topic = bench.topic("command")
        await publish(mosquitto, f"{topic}/mode", '{"id": "first", "value": "fixed"}')
        await host.busy.wait()
        await publish_lines(mosquitto, f"{topic}/setpoint", setpoints("a"))
        await publish(mosquitto, f"{topic}/disable", '{"id": "stop"}')
        await publish_lines(mosquitto, f"{topic}/setpoint", setpoints("b"))
        assert host.gate is not None
        host.gate.set()
        async with asyncio.timeout(20.0):
            while host.asked[-1] != SetSetpoint(2.0):  # noqa: ASYNC110 - the host has no event
                await asyncio.sleep(0.01)
    assert host.asked.count(Disable()) == 1
    assert len(host.asked) <= LARGEST_BACKLOG + COMMANDS_HELD + 3


def setpoints(name: str) -> list[str]:
    """A line for each command; the last of them is told apart by its value."""
    lines = [json.dumps({"id": f"{name}{number}", "value": 1.0}) for number in range(HALF)]
    if name == "b":
        lines.append(json.dumps({"id": "last", "value": 2.0}))
    return lines
