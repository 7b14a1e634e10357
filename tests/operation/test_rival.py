"""Another client of the drive's name: noticed, and operators reach both ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Reset
from tests.operation.peers import (
    PATIENCE_S,
    RememberingHost,
    ask,
    drive_report,
    listening,
    publish,
    serving,
)
from tests.support import Broker, Spawn


async def until(wanted: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not wanted():  # noqa: ASYNC110 - the host has no event
            await asyncio.sleep(0.02)


async def test_a_foreign_client_of_the_name_is_reported(
    mosquitto: Broker, tmp_path: Path, spawn: Spawn
) -> None:
    async with (
        serving(mosquitto, "rival", tmp_path) as bench,
        listening(mosquitto, bench.topic("event")) as ear,
    ):
        address = ("-h", mosquitto.host, "-p", str(mosquitto.port))
        foreign = spawn("mosquitto_sub", *address, "-i", "adaptdrive-rival", "-t", "tests/x")
        event = await ear.until(lambda message: message.content["kind"] == "broker")
        assert "second broker client" in event.content["detail"]
        assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
        assert foreign.poll() is None


async def test_of_two_daemons_one_trips_and_both_stop(mosquitto: Broker, tmp_path: Path) -> None:
    async with (
        serving(mosquitto, "twin", tmp_path / "first") as first,
        serving(mosquitto, "twin", tmp_path / "second") as second,
    ):
        hosts = first.host, second.host
        chatting = [asyncio.create_task(chat(host)) for host in hosts]
        await until(lambda: states(*hosts) == [State.STANDBY, State.TRIPPED])
        await asyncio.sleep(2.0)
        assert states(*hosts) == [State.STANDBY, State.TRIPPED]
        for host in hosts:
            host.asked.clear()
        await publish(mosquitto, first.topic("command/disable"), "OFF")
        await until(lambda: hosts[0].asked == hosts[1].asked == [Disable()])
        await publish(mosquitto, first.topic("command/reset"), '{"id": "again"}')
        await until(lambda: Reset() in hosts[0].asked and Reset() in hosts[1].asked)
        await until(lambda: states(*hosts) == [State.STANDBY, State.TRIPPED])
        for task in chatting:
            task.cancel()
        await asyncio.wait(chatting)


async def test_a_drive_that_connects_ends_no_connection_of_another(
    mosquitto: Broker, tmp_path: Path
) -> None:
    """The name of a drive may go on with a hyphen and a word."""
    async with (
        serving(mosquitto, "pair-probe", tmp_path / "first") as first,
        listening(mosquitto, first.topic("availability")) as ear,
    ):
        async with serving(mosquitto, "pair", tmp_path / "second") as second:
            assert (await ask(second, "ping", '{"id": "a"}'))["accepted"]
        await publish(mosquitto, first.topic("availability"), "end")
        await ear.until(lambda message: message.payload == "end")
        assert {message.payload for message in ear.heard} == {"online", "end"}


async def chat(host: RememberingHost) -> None:
    """Report as a running daemon does."""
    ticks = 0
    while True:
        host.hub.publish(drive_report(ticks))
        await asyncio.sleep(0.1)
        ticks += 12


def states(*hosts: RememberingHost) -> list[State]:
    return sorted(host.report.state for host in hosts)
