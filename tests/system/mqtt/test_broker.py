"""The daemon's side of MQTT with mosquitto and its clients."""

from __future__ import annotations

import asyncio
import gc
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.client import NoAnswerError, send_command
from adaptdrive.mqtt.contract import Profile
from adaptdrive.mqtt.service import MqttService, OperatorLog, broker_of
from adaptdrive.runtime.reports import Event, Severity, State
from adaptdrive.runtime.requests import Disable, SetSetpoint
from tests.support import Broker, MosquittoLauncher, Process, Spawn, captured_lines, stop_process
from tests.unit.mqtt.peers import (
    PATIENCE_S,
    STANDBY,
    RememberingHost,
    ask,
    expect_retained,
    listening,
    publish,
    serving,
)

FOLDER = Path(__file__).parent


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


async def test_the_contract_holds_with_mosquitto(mosquitto: Broker, tmp_path: Path) -> None:
    """Commands and stops, live, retained, kept by the broker, and a probe that comes back."""
    kept = "adaptdrive/real/command/setpoint"
    await publish(mosquitto, kept, '{"id": "kept", "value": 1}', "-r")
    async with (
        listening(mosquitto, "adaptdrive/real/reply", "adaptdrive/real/event") as ear,
        serving(mosquitto, "real", tmp_path) as bench,
    ):
        refused = await ear.on(bench.topic("reply"))
        assert "retain" in refused.content["reason"]
        live = await ask(bench, "setpoint", '{"id": "live", "value": 1}', "-r")
        assert "retain" in live["reason"]
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 2}'))["accepted"]
        assert (await ask(bench, "disable", b"\xff\x00\xfe"))["accepted"]
        await publish(mosquitto, bench.topic("command/disable"), "OFF", "-r")
        event = await ear.on(bench.topic("event"))
        assert "a retained disable" in event.content["detail"]
        assert bench.host.asked == [SetSetpoint(2.0), Disable(), Disable()]
    await expect_retained(bench, "availability", "offline")
    await publish(mosquitto, kept, "", "-r")
    await publish(mosquitto, kept, '{"id": "before the connection", "value": 1}')
    async with serving(mosquitto, "real", tmp_path) as bench:
        assert (await ask(bench, "setpoint", '{"id": "b", "value": 3}'))["accepted"]
        assert bench.host.asked == [SetSetpoint(3.0)]


async def test_events_of_an_outage_are_sent_when_mosquitto_is_back(
    mortal: MortalBroker, tmp_path: Path
) -> None:
    async with serving(mortal.address, "mortal", tmp_path) as bench:
        assert (await ask(bench, "setpoint", '{"id": "a", "value": 1}'))["accepted"]
        await asyncio.to_thread(mortal.kill)
        bench.host.show(replace(STANDBY, state=State.TRIPPED))
        for tick in range(50):
            bench.hub.publish(Event("trip", Severity.ALARM, "over-speed", tick))
            await asyncio.sleep(0.0)
        await asyncio.to_thread(mortal.restart)
        async with listening(mortal.address, bench.topic("#")) as ear:
            await ear.until(lambda message: message.payload == "online")
            assert (await ask(bench, "setpoint", '{"id": "b", "value": 2}'))["accepted"]
            await ear.on(bench.topic("reply"))
        states = [message.content for message in ear.heard if message.topic.endswith("/state")]
        assert states[0]["state"] == "tripped"
    assert bench.host.asked == [SetSetpoint(1.0), SetSetpoint(2.0)]


async def test_the_broker_says_offline_when_the_daemon_is_killed(
    mosquitto: Broker, spawn: Spawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it replied outlives it."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    program = FOLDER / "lonely_drive.py"
    async with listening(mosquitto, "adaptdrive/lonely/#") as ear:
        daemon = spawn(sys.executable, program, str(mosquitto.port), tmp_path)
        await ear.until(lambda message: message.payload == "online")
        await publish(mosquitto, "adaptdrive/lonely/command/setpoint", '{"id": "a", "value": 1}')
        first = await ear.on("adaptdrive/lonely/reply")
        daemon.kill()
        last_will = await ear.on("adaptdrive/lonely/availability")
        assert last_will.payload == "offline"
    async with serving(mosquitto, "lonely", tmp_path) as bench:
        assert await ask(bench, "setpoint", '{"id": "a", "value": 1}') == first.content
        assert bench.host.asked == []


async def test_a_foreign_client_of_the_name_at_mosquitto_is_reported(
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
        assert event.content["trip_kind"] == "second-client"
        assert "end the second daemon" in event.content["remedy"]
        assert (await ask(bench, "disable", '{"id": "a"}'))["accepted"]
        assert foreign.poll() is None


# -- access lists --------------------------------------------------------------------------------


async def test_a_daemon_whose_commands_are_not_delivered_raises_an_alarm(
    tmp_path: Path, free_tcp_port: int, mosquitto_launcher: MosquittoLauncher,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """mosquitto accepts its subscription; the list is wrong, then right."""
    monkeypatch.setattr("adaptdrive.mqtt.session.PROBE_EVERY_S", 0.1)
    monkeypatch.setattr("adaptdrive.mqtt.session.PATIENCE_S", 1.0)
    rights = tmp_path / "rights"
    rights.write_text("topic write #\n")
    launcher = replace(mosquitto_launcher, more=f"acl_file {rights}\nuser root\n")
    process = await asyncio.to_thread(launcher.start, free_tcp_port)
    host = RememberingHost()
    reports, seen = host.hub.subscribe(Event, size=100), list[Event]()
    try:
        async with asyncio.timeout(PATIENCE_S), served(Mqtt(port=free_tcp_port), host):
            while not seen:
                seen += [one for one in await reports.take() if isinstance(one, Event)]
            rights.write_text("topic readwrite #\n")
            process.send_signal(signal.SIGHUP)
            while len(seen) < 2:
                seen += [one for one in await reports.take() if isinstance(one, Event)]
    finally:
        stop_process(process)
    alarm, end = seen[:2]
    assert (alarm.severity, end.severity) == (Severity.ALARM, Severity.INFO)
    assert "no commands" in alarm.detail
    assert "adaptdrive/refused/command/probe" in alarm.detail
    assert end.detail == "commands arrive again"


@asynccontextmanager
async def served(settings: Mqtt, host: RememberingHost) -> AsyncIterator[None]:
    """Serve the drive `refused`."""
    surroundings = OperatorLog(uniform=lambda low, _: 0.1 * low)
    service = MqttService(Profile("refused"), settings, host, host.hub, surroundings)
    running = asyncio.create_task(service.run())
    try:
        yield
    finally:
        running.cancel()
        await asyncio.wait([running])


@pytest.mark.proof
async def test_messages_that_the_broker_refuses_are_logged_once(
    tmp_path: Path, free_tcp_port: int, mosquitto_launcher: MosquittoLauncher
) -> None:
    rights = tmp_path / "rights"
    rights.write_text("topic readwrite #\ntopic deny adaptdrive/refused/event\n")
    launcher = replace(mosquitto_launcher, more=f"acl_file {rights}\nuser root\n")
    process = await asyncio.to_thread(launcher.start, free_tcp_port)
    host = RememberingHost()
    try:
        with captured_lines() as lines:
            async with served(Mqtt(port=free_tcp_port), host):
                for tick in range(100):
                    host.hub.publish(Event("trip", Severity.ALARM, "stale", tick))
                    await asyncio.sleep(0.02)
    finally:
        stop_process(process)
    (refused,) = (line for line in lines if "refuses to deliver" in line["event"])
    assert "Not authorized" in refused["code"]


# -- what only the MQTT library shows ------------------------------------------------------------


@pytest.mark.proof
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


@pytest.mark.proof
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


# -- TLS and a password --------------------------------------------------------------------------


@pytest.fixture
def guarded(
    tmp_path: Path, free_tcp_port: int, mosquitto_launcher: MosquittoLauncher
) -> Iterator[Mqtt]:
    """The settings that a guarded broker accepts; it runs until the test ends."""
    names = ("certificate.pem", "key.pem", "users", "secret")
    certificate, key, users, secret = (tmp_path / name for name in names)
    if shutil.which("openssl") is None or shutil.which("mosquitto_passwd") is None:
        pytest.skip("openssl or mosquitto_passwd is not installed")
    request = ("openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2")
    subject = ("-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1")
    subprocess.run([*request, *subject, "-keyout", key, "-out", certificate],
                   check=True, capture_output=True)  # fmt: skip
    password = "open sesame"
    subprocess.run(["mosquitto_passwd", "-c", "-b", users, "bench", password], check=True)
    secret.write_text(f"{password}\n")
    conf = tmp_path / "mosquitto.conf"
    conf.write_text(
        f"listener {free_tcp_port} 127.0.0.1\npassword_file {users}\n"
        f"certfile {certificate}\nkeyfile {key}\nuser root\n"
    )
    process = subprocess.Popen([mosquitto_launcher.program, "-c", conf])
    yield Mqtt(port=free_tcp_port, tls=True, ca_file=certificate, username="bench",
               password_file=secret)  # fmt: skip
    stop_process(process)
    gc.collect()  # paho leaves the socket of a failed handshake


@pytest.mark.proof
@pytest.mark.filterwarnings("ignore:.*SSLSocket:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
async def test_both_ends_get_in_with_password_and_tls_and_others_stay_outside(
    guarded: Mqtt,
) -> None:
    host = RememberingHost()
    async with served(guarded, host), asyncio.timeout(PATIENCE_S):
        while True:
            try:
                reply = await send_command(broker_of(guarded), "refused", "enable", None, 0.5)
                break
            except NoAnswerError:
                await asyncio.sleep(0.05)
        assert reply.accepted
        for change, problem in (
            ({"username": "stranger"}, "[Nn]ot authori[sz]ed"),
            ({"ca_file": None}, "certificate verify failed"),
            ({"tls": False}, "127.0.0.1"),
            ({"password_file": Path("/nowhere/secret")}, "/nowhere/secret"),
        ):
            wrong = guarded.model_copy(update=change)
            with pytest.raises(NoAnswerError, match=problem):
                await send_command(broker_of(wrong), "refused", "enable", None, 6.0)
