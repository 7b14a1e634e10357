"""What happens when the broker goes, when it comes back, and when the daemon is killed."""

from __future__ import annotations

import asyncio
import gc
import os
import re
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from aiomqtt import MqttError, ProtocolVersion

from adaptdrive.config.services import Mqtt
from adaptdrive.operation.conversation import NoAnswerError, conversation
from adaptdrive.operation.link import connection
from adaptdrive.runtime.reports import Event, Severity, State
from adaptdrive.runtime.requests import Disable, SetSetpoint
from tests.operation.peers import (
    PATIENCE_S,
    STANDBY,
    RememberingHost,
    ask,
    drive_report,
    expect_retained,
    listening,
    load_report,
    publish,
    serving,
)
from tests.support import Broker, MosquittoLauncher, Process, Spawn, captured_lines, stop_process

PROGRAM = Path(__file__).with_name("lonely_drive.py")


class MortalBroker:
    """A mosquitto that goes and comes back on the same port."""

    def __init__(self, launcher: MosquittoLauncher, port: int) -> None:
        self.address = Broker("127.0.0.1", port)
        self._launcher = launcher
        self.process: Process = launcher.start(port)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def restart(self) -> None:
        self.process = self._launcher.start(self.address.port)


@pytest.fixture
def mortal(mosquitto_launcher: MosquittoLauncher, free_tcp_port: int) -> Iterator[MortalBroker]:
    broker = MortalBroker(mosquitto_launcher, free_tcp_port)
    yield broker
    stop_process(broker.process)


def _event(tick: int) -> Event:
    return Event("trip", Severity.ALARM, "over-speed", tick)


async def test_everything_returns_with_the_broker(mortal: MortalBroker, tmp_path: Path) -> None:
    async with serving(mortal.address, "mortal", tmp_path) as bench:
        await ask(bench, "setpoint", '{"id": "a", "value": 1}')
        mortal.kill()
        bench.host.show(replace(STANDBY, state=State.TRIPPED))
        for tick in range(50):
            bench.hub.publish(_event(tick))
            await asyncio.sleep(0.0)
        mortal.restart()
        async with listening(mortal.address, bench.topic("#")) as ear:
            await ear.until(lambda message: message.payload == "online")
            reply = await ask(bench, "setpoint", '{"id": "b", "value": 2}')
            await ear.on(bench.topic("reply"))
        states = [message.content for message in ear.heard if message.topic.endswith("/state")]
        assert states[0]["state"] == "tripped"
        assert reply["accepted"]
    assert bench.host.asked == [SetSetpoint(1.0), SetSetpoint(2.0)]


async def test_events_of_an_outage_are_kept_on_disk_and_sent_in_order(
    mortal: MortalBroker, tmp_path: Path
) -> None:
    async with serving(mortal.address, "keeper", tmp_path) as bench:
        mortal.kill()
        for tick in range(25):
            bench.hub.publish(_event(tick))
        await asyncio.sleep(0.05)
    # The daemon is gone with its events unsent; the next one finds them and adds its own.
    mortal.restart()
    async with (
        listening(mortal.address, "adaptdrive/keeper/event") as ear,
        serving(mortal.address, "keeper", tmp_path) as bench,
    ):
        bench.hub.publish(_event(25))
        await ear.until(lambda message: message.content["tick"] == 25)
    ticks = [message.content["tick"] for message in ear.heard]
    assert list(dict.fromkeys(ticks)) == list(range(26))
    times = [message.content["time"] for message in ear.heard]
    assert times == sorted(times)


async def test_telemetry_of_an_outage_is_not_sent_as_new(
    mortal: MortalBroker, tmp_path: Path
) -> None:
    async with serving(mortal.address, "fresh", tmp_path) as bench:
        mortal.kill()
        await asyncio.sleep(0.1)
        bench.hub.publish(load_report(1))
        bench.hub.publish(drive_report(1))
        await asyncio.sleep(0.1)
        mortal.restart()
        async with listening(mortal.address, bench.topic("#")) as ear:
            await ear.until(lambda message: message.payload == "online")
            bench.hub.publish(load_report(2))
            bench.hub.publish(drive_report(2))
            await ear.on(bench.topic("telemetry/load"))
            await ear.on(bench.topic("telemetry/drive"))
    load, drive = (
        [message.content for message in ear.heard if message.topic.endswith(name)]
        for name in ("telemetry/load", "telemetry/drive")
    )
    assert [content["k"] for content in load] == [2]
    assert [content["ticks"] for content in drive] == [2]


async def test_the_daemon_starts_without_a_broker(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, tmp_path: Path
) -> None:
    """It tries again and again on a port where nothing speaks MQTT, until a broker is there."""
    tried, tried_again = asyncio.Event(), asyncio.Event()

    def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        (tried_again if tried.is_set() else tried).set()
        writer.close()

    address = Broker("127.0.0.1", free_tcp_port)
    async with (
        await asyncio.start_server(hang_up, address.host, address.port) as nothing,
        serving(address, "patient", tmp_path, await_online=False) as bench,
    ):
        async with asyncio.timeout(PATIENCE_S):
            await tried_again.wait()
        nothing.close()
        process = await asyncio.to_thread(mosquitto_launcher.start, free_tcp_port)
        try:
            await expect_retained(bench, "availability", "online")
            assert (await ask(bench, "enable", '{"id": "a"}'))["accepted"]
        finally:
            stop_process(process)


async def test_a_broker_that_takes_small_packets_only_still_delivers_a_stop(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, tmp_path: Path
) -> None:
    """Its `state` is larger than the broker takes, which would end each connection at once."""
    launcher = replace(mosquitto_launcher, more="max_packet_size 300\n")
    process = await asyncio.to_thread(launcher.start, free_tcp_port)
    try:
        async with serving(Broker("127.0.0.1", free_tcp_port), "small", tmp_path) as bench:
            assert (await ask(bench, "disable", "any"))["accepted"]
            assert bench.host.asked == [Disable()]
            assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
    finally:
        stop_process(process)


async def test_a_message_above_the_size_limit_of_the_broker_does_not_end_the_connection(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, tmp_path: Path
) -> None:
    """A stop that arrived while the daemon connected again would be lost."""
    launcher = replace(mosquitto_launcher, more="message_size_limit 300\n")
    process = await asyncio.to_thread(launcher.start, free_tcp_port)
    try:
        with captured_lines() as lines:
            async with serving(Broker("127.0.0.1", free_tcp_port), "limit", tmp_path) as bench:
                bench.host.hub.publish(Event("trip", Severity.ALARM, 400 * "x", 1))
                assert (await ask(bench, "disable", "any"))["accepted"]
                assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert not [line for line in lines if line["event"] == "broker lost"]
        assert "Packet too large" in {line.get("code") for line in lines}
    finally:
        stop_process(process)


async def test_a_command_under_way_ends_although_the_broker_is_lost(
    mortal: MortalBroker, tmp_path: Path
) -> None:
    gate = asyncio.Event()
    async with serving(mortal.address, "half", tmp_path, RememberingHost(gate=gate)) as bench:
        await publish(mortal.address, bench.topic("command/setpoint"), '{"id": "a", "value": 1}')
        await bench.host.busy.wait()
        mortal.kill()
        mortal.restart()
        await expect_retained(bench, "availability", "online")
        gate.set()
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert bench.host.asked == [SetSetpoint(1.0)]


async def test_a_broker_that_hangs_is_given_up_and_told_when_it_wakes(
    mortal: MortalBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.operation.link.TIMEOUT_S", 0.3)
    async with serving(mortal.address, "frozen", tmp_path) as bench:
        mortal.process.send_signal(signal.SIGSTOP)
        bench.host.show(replace(STANDBY, reason="while the broker hangs"))
        await asyncio.sleep(1.0)  # longer than a publication waits, attempts to connect included
        bench.host.show(replace(STANDBY, reason="after several attempts"))
        mortal.process.send_signal(signal.SIGCONT)
        async with listening(mortal.address, bench.topic("state")) as ear:
            await ear.until(lambda message: "several" in message.payload)
        assert (await ask(bench, "enable", '{"id": "a"}'))["accepted"]


async def test_a_broker_that_hangs_keeps_nobody_from_stopping(
    mortal: MortalBroker, tmp_path: Path
) -> None:
    async with asyncio.timeout(PATIENCE_S), serving(mortal.address, "frozen", tmp_path):
        mortal.process.send_signal(signal.SIGSTOP)
    mortal.process.send_signal(signal.SIGCONT)


async def test_an_answer_that_comes_after_the_wait_for_it_is_not_logged(
    mortal: MortalBroker, caplog: pytest.LogCaptureFixture
) -> None:
    place = Mqtt(host=mortal.address.host, port=mortal.address.port)
    async with connection(place, ProtocolVersion.V311, None, None) as client:
        mortal.process.send_signal(signal.SIGSTOP)
        with pytest.raises(MqttError):
            await client.subscribe("late", timeout=0.1)
        mortal.process.send_signal(signal.SIGCONT)
        await client.subscribe("next", timeout=PATIENCE_S)
    assert caplog.records == []


async def test_a_broker_that_hangs_up_on_a_publication_leaves_no_line_in_the_log(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, caplog: pytest.LogCaptureFixture
) -> None:
    launcher = replace(mosquitto_launcher, more="max_qos 0\n")
    process = await asyncio.to_thread(launcher.start, free_tcp_port)
    place = Mqtt(host="127.0.0.1", port=free_tcp_port)
    try:
        async with connection(place, ProtocolVersion.V311, None, None) as client:
            with pytest.raises(MqttError):
                await client.publish("topic", b"", qos=1, timeout=1.0)
        del client
        gc.collect()
    finally:
        stop_process(process)
    assert caplog.records == []


async def test_the_broker_says_offline_when_the_daemon_is_killed(
    mosquitto: Broker, spawn: Spawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    async with listening(mosquitto, "adaptdrive/lonely/#") as ear:
        daemon = spawn(sys.executable, PROGRAM, str(mosquitto.port), tmp_path)
        await ear.until(lambda message: message.payload == "online")
        await publish(mosquitto, "adaptdrive/lonely/command/setpoint", '{"id": "a", "value": 1}')
        first = await ear.on("adaptdrive/lonely/reply")
        daemon.kill()
        last_will = await ear.on("adaptdrive/lonely/availability")
        assert last_will.payload == "offline"
    # What it replied outlived it.
    async with serving(mosquitto, "lonely", tmp_path) as bench:
        assert await ask(bench, "setpoint", '{"id": "a", "value": 1}') == first.content
        assert bench.host.asked == []


async def test_discarded_events_are_counted_in_an_event(
    mortal: MortalBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with serving(mortal.address, "overflow", tmp_path) as bench:
        monkeypatch.setattr(bench.service._intake.outbox, "limit", 10)
        mortal.kill()
        for tick in range(25):
            bench.hub.publish(_event(tick))
            await asyncio.sleep(0.0)
        await asyncio.sleep(0.1)
        mortal.restart()
        async with listening(mortal.address, bench.topic("event")) as ear:
            lost = await ear.until(lambda message: message.content["kind"] == "outbox")
    assert "15 events" in lost.content["detail"]


@pytest.mark.parametrize("obstacle", ["fifo", "file for the folder"])
async def test_without_a_log_commands_are_carried_out(
    mosquitto: Broker, tmp_path: Path, obstacle: str
) -> None:
    folder = tmp_path / "state"
    if obstacle == "file for the folder":
        folder.write_text("in the way")
    else:
        folder.mkdir()
        os.mkfifo(folder / "unkept.log")
    async with (
        listening(mosquitto, "adaptdrive/unkept/event") as ear,
        serving(mosquitto, "unkept", folder) as bench,
    ):
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        event = await ear.until(lambda message: message.content["kind"] == "recording")
        assert "unkept.log" in event.content["detail"]
    assert bench.host.asked == [SetSetpoint(1.0), Disable()]


async def test_the_farewell_of_another_daemon_does_not_stand(
    mosquitto: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.operation.session.ONLINE_EVERY_S", 0.1)
    async with serving(mosquitto, "outlived", tmp_path) as bench:
        await publish(mosquitto, "adaptdrive/outlived/availability", "offline", "-r")
        await expect_retained(bench, "availability", "online")
    await expect_retained(bench, "availability", "offline")


async def test_a_state_folder_deleted_during_the_run_is_reported(
    mosquitto: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "state"
    async with (
        listening(mosquitto, "adaptdrive/deleted/event") as ear,
        serving(mosquitto, "deleted", folder) as bench,
    ):
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        shutil.rmtree(folder)
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        event = await ear.until(lambda message: message.content["kind"] == "recording")
        assert re.search(r"deleted\.log/.*\.log was removed", event.content["detail"])


async def test_a_log_that_is_never_written_delays_no_stop(
    mosquitto: Broker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("adaptdrive.recording.log_writer.LogWriter.start", lambda _: None)
    async with serving(mosquitto, "disk-hangs", tmp_path) as bench:
        assert (await ask(bench, "disable", '{"id": "b"}'))["accepted"]
        assert (await ask(bench, "enable", '{"id": "a"}'))["accepted"]


@pytest.mark.parametrize("timeout_s", [0.2, 60.0])
def test_a_silent_name_server_keeps_no_client_and_no_end(
    monkeypatch: pytest.MonkeyPatch, timeout_s: float
) -> None:
    """A client ends at its own time; one without, and a daemon, when they are asked to."""
    answered = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: answered.wait() and [])

    async def attempt() -> None:
        end_s = asyncio.get_running_loop().time() + timeout_s
        async with asyncio.timeout(1.0), conversation(Mqtt(host="broker"), "motor", end_s):
            pytest.fail("there is no broker")

    started_s = time.monotonic()
    with pytest.raises((NoAnswerError, TimeoutError)) as caught:
        asyncio.run(attempt())
    answered.set()
    assert isinstance(caught.value, TimeoutError) == (timeout_s > 1.0)
    assert time.monotonic() - started_s < PATIENCE_S  # without an end, were it waited for
