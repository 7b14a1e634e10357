"""Brokers that refuse something, know the older protocol, or give the name to another client."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from aiomqtt import Will

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.connection import Broker, BrokerLink, ClientName
from adaptdrive.mqtt.contract import Profile
from adaptdrive.mqtt.service import MqttService, OperatorLog
from adaptdrive.runtime.reports import Event, Severity, State
from adaptdrive.runtime.requests import Disable, Request, Reset, SetSetpoint
from tests.support import captured_lines
from tests.unit.mqtt.memory_broker import V311, MemoryBroker, MemoryClient
from tests.unit.mqtt.peers import (
    Bench,
    RememberingHost,
    ask,
    drive_report,
    expect_retained,
    listening,
    publish,
    serving,
)


def told(bench: Bench) -> Callable[[], list[tuple[Severity, str]]]:
    """Events of the broker since the last call."""
    reports = bench.hub.subscribe(Event, size=100)

    def taken() -> list[tuple[Severity, str]]:
        events = [one for one in reports.drain() if isinstance(one, Event)]
        return [(one.severity, one.detail) for one in events if one.kind == "broker"]

    return taken


async def test_a_daemon_that_hears_no_commands_raises_an_alarm_once(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    broker.refused = ("adaptdrive/deaf/command/+", "adaptdrive/deaf/command/#")
    async with (
        listening(broker, "adaptdrive/deaf/event") as ear,
        serving(broker, "deaf", tmp_path) as bench,
    ):
        alarm = (await ear.on(bench.topic("event"))).content
        await asyncio.sleep(500.0)
        await publish(broker, bench.topic("event"), '{"kind": "end"}')
        assert (await ear.on(bench.topic("event"))).content == {"kind": "end"}
    assert (alarm["kind"], alarm["severity"]) == ("broker", "alarm")
    assert "no commands: the broker refuses the subscription to" in alarm["detail"]


@pytest.mark.parametrize("fault", ["", "refused", "unwanted"])
async def test_a_daemon_that_hears_its_commands_raises_none(
    broker: MemoryBroker, bench: Bench, fault: str
) -> None:
    """Nor one whose broker refuses the probe alone, as an access list of before it does."""
    probe = bench.topic("command/probe")
    if fault:
        setattr(broker, fault, (probe,))
    broker.kill()
    broker.restart()
    taken = told(bench)
    await asyncio.sleep(500.0)
    assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
    assert taken() == []


async def test_a_daemon_whose_commands_are_lost_on_the_way_raises_an_alarm(
    broker: MemoryBroker, bench: Bench
) -> None:
    """mosquitto accepts a subscription whose messages the access list withholds."""
    taken = told(bench)
    await asyncio.sleep(65.0)
    assert taken() == []
    broker.withheld = (bench.topic("command/probe"),)
    await asyncio.sleep(200.0)
    ((alarm, text),) = taken()
    broker.withheld = ()
    await asyncio.sleep(200.0)
    assert alarm is Severity.ALARM
    assert "no commands" in text
    assert bench.topic("command/probe") in text
    assert taken() == [(Severity.INFO, "commands arrive again")]


async def test_a_broker_of_the_older_protocol_has_the_same_contract(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    """A retained command is known as one at the subscription only."""
    broker.protocols = (V311,)
    await publish(broker, "adaptdrive/older/command/setpoint", '{"id": "x", "value": 1}', "-r")
    async with (
        listening(broker, "adaptdrive/older/reply") as ear,
        serving(broker, "older", tmp_path) as bench,
    ):
        assert "retain" in (await ear.on("adaptdrive/older/reply")).content["reason"]
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 2}'))["accepted"]
        assert not (await ask(bench, "setpoint", '{"id": "b", "value": 9}'))["accepted"]
    assert bench.host.asked == [SetSetpoint(2.0)]
    await expect_retained(bench, "availability", "offline")


@pytest.mark.parametrize(
    ("key", "damage"),
    [
        ("password_file", lambda path: path.write_bytes(b"\xff\x00\xfe")),
        ("password_file", Path.mkdir),
        ("password_file", os.mkfifo),
        ("ca_file", Path.touch),  # no certificate must not mean the machine's authorities
        ("ca_file", os.mkfifo),
    ],
)
async def test_a_secret_that_cannot_be_read_is_tried_again(
    broker: MemoryBroker, tmp_path: Path, key: str, damage: Callable[[Path], object]
) -> None:
    spoilt, host = tmp_path / "spoilt", RememberingHost()
    damage(spoilt)
    settings = Mqtt(tls=True).model_copy(update={key: spoilt})
    service = MqttService(Profile("guarded"), settings, host, host.hub, OperatorLog(uniform=min))
    with captured_lines() as lines:
        running = asyncio.create_task(service.run())
        await asyncio.sleep(100.0)
    assert not running.done()
    assert [line["event"] for line in lines] == ["broker lost"]
    assert "spoilt" in lines[0]["problem"]
    assert broker.names == []
    if key == "password_file":
        spoilt.rename(tmp_path / "put aside")
        spoilt.write_text("open sesame\n")
        await asyncio.sleep(60.0)
        assert broker.names[-1] == "adaptdrive-guarded"
    running.cancel()
    await asyncio.wait([running])


# -- another client of the name ------------------------------------------------------------------


@asynccontextmanager
async def foreign(broker: MemoryBroker, name: str) -> AsyncIterator[None]:
    """Another client of a name, which stays."""
    client = MemoryClient(broker, identifier=name)
    async with client:
        yield
        broker.take(client)  # where it has lost the name meanwhile


async def test_a_foreign_client_of_the_name_is_reported(broker: MemoryBroker, bench: Bench) -> None:
    taken = told(bench)
    async with foreign(broker, "adaptdrive-motor"):
        await asyncio.sleep(10.0)
        assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
        ((_, detail),) = taken()
        assert "second broker client" in detail
        assert bench.host.report.state is State.TRIPPED
        assert (await ask(bench, "reset", '{"id": "b"}'))["accepted"]
        await asyncio.sleep(10.0)
    assert broker.names[-1] == "adaptdrive-motor"  # it has taken its name again


async def test_of_two_daemons_one_trips_and_both_stop(broker: MemoryBroker, tmp_path: Path) -> None:
    async with (
        serving(broker, "twin", tmp_path / "first") as first,
        serving(broker, "twin", tmp_path / "second") as second,
    ):
        hosts = first.host, second.host
        chatting = [asyncio.create_task(chat(host)) for host in hosts]
        await asyncio.sleep(100.0)
        assert states(*hosts) == [State.STANDBY, State.TRIPPED]
        for host in hosts:
            host.asked.clear()
        await publish(broker, first.topic("command/disable"), "OFF")
        assert hosts[0].asked == hosts[1].asked == [Disable()]
        await publish(broker, first.topic("command/reset"), '{"id": "again"}')
        await asyncio.sleep(100.0)
        assert all(Reset() in host.asked for host in hosts)
        assert states(*hosts) == [State.STANDBY, State.TRIPPED]
        for task in chatting:
            task.cancel()
        await asyncio.wait(chatting)


async def test_a_drive_that_connects_ends_no_connection_of_another(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    """The name of a drive may go on with a hyphen and a word."""
    async with (
        serving(broker, "pair-probe", tmp_path / "first"),
        listening(broker, "adaptdrive/pair-probe/availability") as ear,
        serving(broker, "pair", tmp_path / "second") as second,
    ):
        assert (await ask(second, "ping", '{"id": "a"}'))["accepted"]
        await publish(broker, "adaptdrive/pair-probe/availability", "end")
        await ear.until(lambda message: message.payload == "end")
    assert {message.payload for message in ear.heard} == {"online", "end"}


async def test_a_broker_that_closes_the_connection_again_and_again_is_a_sign(
    broker: MemoryBroker, bench: Bench
) -> None:
    """Not every broker says that it gives a name away; the drive does not trip for that."""
    taken = told(bench)
    for closings, reported in ((2, 0), (1, 1)):
        for _ in range(closings):
            broker.kill()
            broker.restart()
            await asyncio.sleep(20.0)
        assert len(taken()) == reported
    assert bench.host.report.state is State.STANDBY


async def test_a_daemon_that_loses_its_name_after_an_outage_connects_again_soon(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    """The waits of the outage have nothing to do with the name: meanwhile no stop is heard."""
    waits: list[float] = []

    def wait(_: float, high: float) -> float:
        waits.append(high)
        return 0.01

    broker.away = True
    async with serving(broker, "late", tmp_path, await_online=False, uniform=wait) as bench:
        await asyncio.sleep(0.2)
        broker.restart()
        await expect_retained(bench, "availability", "online")
        assert waits[-1] > 1.0
        async with foreign(broker, "adaptdrive-late"):
            await expect_retained(bench, "availability", "online")
            assert waits[-1] <= 0.5


class RunningHost(RememberingHost):
    """A drive that runs: a reset changes nothing."""

    async def execute(self, request: Request) -> State:
        self.asked.append(request)
        return State.RUNNING


async def test_a_reset_of_a_drive_that_runs_ends_no_connection(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with (
        serving(broker, "runs", tmp_path, RunningHost()) as bench,
        foreign(broker, "adaptdrive-runs"),
    ):
        await asyncio.sleep(10.0)
        joined = len(broker.names)
        assert (await ask(bench, "reset", '{"id": "a"}'))["accepted"]
        await asyncio.sleep(10.0)
        assert len(broker.names) == joined


async def chat(host: RememberingHost) -> None:
    """Report as a running daemon does."""
    ticks = 0
    while True:
        host.hub.publish(drive_report(ticks))
        await asyncio.sleep(0.1)
        ticks += 12


def states(*hosts: RememberingHost) -> list[State]:
    return sorted(host.report.state for host in hosts)


# -- waits and clocks ----------------------------------------------------------------------------


def test_waiting_doubles_up_to_a_limit_and_starts_anew_after_a_good_connection() -> None:
    name = ClientName("adaptdrive-motor", lambda: 0.0, lambda _: None, lambda _: None)
    link = BrokerLink(Broker(), name, Will("x"), lambda _, high: high)
    assert [link.pause_s(0.0) for _ in range(8)] == [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert link.pause_s(3.0) == 30.0  # a broker that hangs up at once is no good connection
    assert link.pause_s(60.0) == 0.5
