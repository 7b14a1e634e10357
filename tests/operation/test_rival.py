"""Another client of the drive's name: noticed, and operators reach both ends."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from adaptdrive.operation.name import ClientName
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Request, Reset
from tests.operation.peers import (
    PATIENCE_S,
    RememberingHost,
    ask,
    drive_report,
    expect_retained,
    listening,
    publish,
    serving,
)
from tests.support import Broker, MosquittoLauncher, Spawn, stop_process


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


class RunningHost(RememberingHost):
    """A drive that runs: a reset changes nothing."""

    async def execute(self, request: Request) -> State:
        self.asked.append(request)
        return State.RUNNING


async def test_a_daemon_that_loses_its_name_after_an_outage_connects_again_soon(
    free_tcp_port: int, mosquitto_launcher: MosquittoLauncher, tmp_path: Path, spawn: Spawn
) -> None:
    """The waits of the outage have nothing to do with the name: meanwhile no stop is heard."""
    waits: list[tuple[str, float]] = []
    name: list[ClientName] = []

    def wait(_: float, high: float) -> float:
        waits.append((name[0].present if name else "", high))
        return 0.01

    broker = Broker("127.0.0.1", free_tcp_port)
    async with serving(broker, "late", tmp_path, await_online=False, uniform=wait) as bench:
        name.append(bench.service._link._name)
        await until(lambda: len(waits) > 8)
        process = mosquitto_launcher.start(free_tcp_port)
        await expect_retained(bench, "availability", "online")
        assert waits[-1][1] > 1.0
        address = ("-h", broker.host, "-p", str(broker.port))
        spawn("mosquitto_sub", *address, "-i", "adaptdrive-late", "-t", "tests/x")
        await until(lambda: name[0].given_way and waits[-1][0] == name[0].present)
        stop_process(process)
        assert next(high for known, high in waits if known == name[0].present) <= 0.5


async def test_a_reset_of_a_drive_that_runs_ends_no_connection(
    mosquitto: Broker, tmp_path: Path, spawn: Spawn
) -> None:
    async with (
        serving(mosquitto, "runs", tmp_path, RunningHost()) as bench,
        listening(mosquitto, bench.topic("event")) as ear,
    ):
        address = ("-h", mosquitto.host, "-p", str(mosquitto.port))
        spawn("mosquitto_sub", *address, "-i", "adaptdrive-runs", "-t", "tests/x")
        await ear.until(lambda message: message.content["kind"] == "broker")
        assert (await ask(bench, "reset", '{"id": "a"}'))["accepted"]
        assert (await ask(bench, "ping", '{"id": "b"}'))["accepted"]
        assert bench.service._link._name.given_way


async def chat(host: RememberingHost) -> None:
    """Report as a running daemon does."""
    ticks = 0
    while True:
        host.hub.publish(drive_report(ticks))
        await asyncio.sleep(0.1)
        ticks += 12


def states(*hosts: RememberingHost) -> list[State]:
    return sorted(host.report.state for host in hosts)
