"""What happens when the broker goes, hangs and comes back, and when the disk of the log fails."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.runtime.reports import DriveReport, Event, LoadReport, Severity, State
from adaptdrive.runtime.requests import Disable, SetSetpoint
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import (
    STANDBY,
    Bench,
    RememberingHost,
    ask,
    drive_report,
    expect_retained,
    listening,
    load_report,
    publish,
    serving,
)
from tests.unit.recording.disk import Disk


def _event(tick: int) -> Event:
    return Event("trip", Severity.ALARM, "over-speed", tick)


async def test_everything_returns_with_the_broker(broker: MemoryBroker, bench: Bench) -> None:
    await ask(bench, "setpoint", '{"id": "a", "value": 1}')
    broker.kill()
    bench.host.show(replace(STANDBY, state=State.TRIPPED))
    async with asyncio.timeout(3600.0):
        await asyncio.sleep(1000.0)
    broker.restart()
    async with listening(broker, bench.topic("#")) as ear:
        await ear.until(lambda message: message.payload == "online")
        reply = await ask(bench, "setpoint", '{"id": "b", "value": 2}')
    states = [message.content for message in ear.heard if message.topic.endswith("/state")]
    assert states[0]["state"] == "tripped"
    assert reply["accepted"]
    assert bench.host.asked == [SetSetpoint(1.0), SetSetpoint(2.0)]


async def test_events_of_an_outage_are_kept_on_disk_and_sent_in_order(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    """The daemon is gone with its events unsent; the next one finds them and adds its own."""
    async with serving(broker, "keeper", tmp_path) as bench:
        broker.kill()
        for tick in range(25):
            bench.hub.publish(_event(tick))
        await asyncio.sleep(0.05)
    broker.restart()
    async with (
        listening(broker, "adaptdrive/keeper/event") as ear,
        serving(broker, "keeper", tmp_path) as bench,
    ):
        bench.hub.publish(_event(25))
        await ear.until(lambda message: message.content["tick"] == 25)
    assert [message.content["tick"] for message in ear.heard] == list(range(26))
    times = [message.content["time"] for message in ear.heard]
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("name", "report", "key"),
    [("telemetry/load", load_report, "k"), ("telemetry/drive", drive_report, "ticks")],
)
async def test_telemetry_of_an_outage_is_not_sent_as_new(
    broker: MemoryBroker,
    bench: Bench,
    name: str,
    report: Callable[[int], LoadReport | DriveReport],
    key: str,
) -> None:
    broker.kill()
    await asyncio.sleep(0.1)
    bench.hub.publish(report(1))
    await asyncio.sleep(0.1)
    async with listening(broker_again(broker), bench.topic("#")) as ear:
        await ear.until(lambda message: message.payload == "online")
        bench.hub.publish(report(2))
        await ear.on(bench.topic(name))
    sent = [message.content[key] for message in ear.heard if message.topic.endswith(name)]
    assert sent == [2]


def broker_again(broker: MemoryBroker) -> MemoryBroker:
    broker.restart()
    return broker


async def test_the_daemon_starts_without_a_broker(broker: MemoryBroker, tmp_path: Path) -> None:
    broker.away = True
    async with serving(broker, "patient", tmp_path, await_online=False) as bench:
        await asyncio.sleep(500.0)
        broker.restart()
        await expect_retained(bench, "availability", "online")
        assert (await ask(bench, "enable", '{"id": "a"}'))["accepted"]


async def test_a_command_under_way_ends_although_the_broker_is_lost(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    gate = asyncio.Event()
    async with serving(broker, "half", tmp_path, RememberingHost(gate=gate)) as bench:
        await publish(broker, bench.topic("command/setpoint"), '{"id": "a", "value": 1}')
        await bench.host.busy.wait()
        broker.kill()
        broker.restart()
        await expect_retained(bench, "availability", "online")
        gate.set()
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert bench.host.asked == [SetSetpoint(1.0)]


async def test_a_broker_that_hangs_is_given_up_and_told_when_it_wakes(
    broker: MemoryBroker, bench: Bench
) -> None:
    broker.hangs = True
    bench.host.show(replace(STANDBY, reason="while the broker hangs"))
    await asyncio.sleep(100.0)  # many attempts to connect
    bench.host.show(replace(STANDBY, reason="after several attempts"))
    broker.hangs = False
    async with listening(broker, bench.topic("state")) as ear:
        await ear.until(lambda message: "several" in message.payload)
    assert (await ask(bench, "enable", '{"id": "a"}'))["accepted"]


@pytest.mark.parametrize("hung_s", [0.0, 7.0, 60.0])
async def test_a_broker_that_hangs_keeps_nobody_from_stopping(
    broker: MemoryBroker, tmp_path: Path, hung_s: float
) -> None:
    loop = asyncio.get_running_loop()
    async with serving(broker, "frozen", tmp_path):
        broker.hangs = True
        await asyncio.sleep(hung_s)
        began_s = loop.time()
    assert loop.time() - began_s <= 3.0 + 1e-3  # two farewells and the goodbye


async def test_discarded_events_are_counted_in_an_event(broker: MemoryBroker, bench: Bench) -> None:
    bench.service._intake.outbox.limit = 10
    broker.kill()
    for tick in range(25):
        bench.hub.publish(_event(tick))
        await asyncio.sleep(0.0)
    await asyncio.sleep(0.1)
    async with listening(broker_again(broker), bench.topic("event")) as ear:
        lost = await ear.until(lambda message: message.content["kind"] == "outbox")
    assert "15 events" in lost.content["detail"]


@pytest.mark.parametrize("obstacle", ["fifo", "file for the folder"])
async def test_without_a_log_commands_are_carried_out(
    broker: MemoryBroker, tmp_path: Path, obstacle: str
) -> None:
    folder = tmp_path / "state"
    if obstacle == "file for the folder":
        folder.write_text("in the way")
    else:
        folder.mkdir()
        os.mkfifo(folder / "unkept.log")
    async with (
        listening(broker, "adaptdrive/unkept/event") as ear,
        serving(broker, "unkept", folder) as bench,
    ):
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        event = await ear.until(lambda message: message.content["kind"] == "recording")
        assert "unkept.log" in event.content["detail"]
    assert bench.host.asked == [SetSetpoint(1.0), Disable()]


async def test_a_state_folder_deleted_during_the_run_is_reported(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    folder = tmp_path / "state"
    async with (
        listening(broker, "adaptdrive/deleted/event") as ear,
        serving(broker, "deleted", folder) as bench,
    ):
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        shutil.rmtree(folder)
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        event = await ear.until(lambda message: message.content["kind"] == "recording")
        assert re.search(r"deleted\.log/.*\.log was removed", event.content["detail"])


async def test_a_log_that_is_never_written_delays_no_stop(log_disk: Disk, bench: Bench) -> None:
    with log_disk.stalled():
        await publish(bench.broker, bench.topic("command/enable"), '{"id": "a"}')
        await publish(bench.broker, bench.topic("command/disable"), '{"id": "b"}')
        assert bench.host.asked == [Disable()]  # at its arrival
        await asyncio.sleep(5.0)
        assert bench.host.asked == [Disable()]
        assert (await ask(bench, "enable", '{"id": "c"}'))["accepted"]


async def test_the_farewell_of_another_daemon_does_not_stand(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with serving(broker, "outlived", tmp_path) as bench:
        await publish(broker, "adaptdrive/outlived/availability", "offline", "-r")
        await expect_retained(bench, "availability", "online")
    await expect_retained(bench, "availability", "offline")
