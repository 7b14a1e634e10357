"""More commands than can be answered: memory stays bounded, and a stop is never lost."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

from adaptdrive.operation.board import Mailbox
from adaptdrive.operation.clock import LogRation
from adaptdrive.operation.session import COMMANDS_HELD
from adaptdrive.runtime.requests import Disable, SetMode, SetSetpoint
from tests.operation.peers import (
    PATIENCE_S,
    Bench,
    RememberingHost,
    listening,
    publish,
    publish_lines,
    serving,
)
from tests.support import Broker

MORE = COMMANDS_HELD + 50


async def test_a_full_mailbox_loses_its_oldest_and_counts() -> None:
    box: Mailbox[int] = Mailbox(4)
    for number in range(10):
        box.put(number)
    assert [await box.take() for _ in range(4)] == [6, 7, 8, 9]
    assert box.dropped == 6


async def test_a_stop_acts_ahead_of_a_command_under_way(mosquitto: Broker, tmp_path: Path) -> None:
    gate = asyncio.Event()
    host = RememberingHost(gate=gate)
    async with serving(mosquitto, "flooded", tmp_path, host) as bench:
        topic = bench.topic("command")
        await publish(mosquitto, f"{topic}/mode", '{"id": "first", "value": "fixed"}')
        await host.busy.wait()
        await publish_lines(mosquitto, f"{topic}/setpoint", setpoints("before"))
        await publish(mosquitto, f"{topic}/disable", '{"id": "stop"}')
        await until_asked(bench, Disable())
        assert not gate.is_set()
        assert [type(request) for request in host.asked] == [SetMode, Disable]


async def test_commands_before_a_stop_are_refused_by_it(mosquitto: Broker, tmp_path: Path) -> None:
    gate = asyncio.Event()
    host = RememberingHost(gate=gate)
    async with (
        serving(mosquitto, "overtaken", tmp_path, host) as bench,
        listening(mosquitto, bench.topic("reply")) as ear,
    ):
        topic = bench.topic("command")
        await publish(mosquitto, f"{topic}/mode", '{"id": "first", "value": "fixed"}')
        await host.busy.wait()
        await publish(mosquitto, f"{topic}/enable", '{"id": "before"}')
        await publish(mosquitto, f"{topic}/disable", '{"id": "stop"}')
        stop = await ear.on(bench.topic("reply"))
        assert (stop.content["id"], stop.content["accepted"]) == ("stop", True)
        gate.set()
        refused = await ear.until(lambda reply: reply.content["id"] == "before")
        assert "a disable arrived after this command" in refused.content["reason"]
        await publish(mosquitto, f"{topic}/setpoint", '{"id": "after", "value": 2}')
        assert (await ear.until(lambda reply: reply.content["id"] == "after")).content["accepted"]
    assert [type(request) for request in host.asked] == [SetMode, Disable, SetSetpoint]


async def test_a_flood_costs_its_oldest_commands(mosquitto: Broker, tmp_path: Path) -> None:
    gate = asyncio.Event()
    host = RememberingHost(gate=gate)
    async with serving(mosquitto, "drowned", tmp_path, host) as bench:
        topic = bench.topic("command")
        await publish(mosquitto, f"{topic}/mode", '{"id": "first", "value": "fixed"}')
        await host.busy.wait()
        await publish_lines(mosquitto, f"{topic}/setpoint", [*setpoints("a"), last()])
        gate.set()
        await until_asked(bench, SetSetpoint(2.0))
    assert len(host.asked) <= COMMANDS_HELD + 1


async def test_a_flood_of_stops_is_carried_out_whole(mosquitto: Broker, tmp_path: Path) -> None:
    async with serving(mosquitto, "stops", tmp_path) as bench:
        await publish_lines(mosquitto, bench.topic("command/disable"), ["x"] * MORE)
        async with asyncio.timeout(PATIENCE_S):
            while len(bench.host.asked) < MORE:  # noqa: ASYNC110 - the host has no event
                await asyncio.sleep(0.01)
    assert bench.host.asked == [Disable()] * MORE


def test_log_lines_beyond_their_ration_are_counted() -> None:
    now_s = [0.0]
    ration = LogRation(lambda: now_s[0], lines=3, interval_s=10.0)
    assert [ration.take() for _ in range(8)] == [0, 0, 0, None, None, None, None, None]
    now_s[0] = 10.0
    assert [ration.take() for _ in range(2)] == [5, 0]


async def until_asked(bench: Bench, wanted: object) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while wanted not in bench.host.asked:  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.01)


def setpoints(name: str) -> list[str]:
    return [json.dumps({"id": f"{name}{number}", "value": 1.0}) for number in range(MORE)]


def last() -> str:
    return json.dumps({"id": "last", "value": 2.0})
