"""`adaptdrive list` and the options that all operator commands share."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from adaptdrive.cli.contact import Contact
from adaptdrive.errors import ConfigurationError
from adaptdrive.runtime.requests import SetSetpoint
from tests.cli.test_cli import adaptdrive, at
from tests.operation.peers import drive_report, listening, publish, serving
from tests.scenes.system.site import motor_configuration
from tests.support import Broker, MosquittoLauncher, stop_process


async def test_the_list_has_every_drive_with_units_and_the_tripped_one_first(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int, tmp_path: Path
) -> None:
    process = mosquitto_launcher.start(free_tcp_port)
    broker = Broker("127.0.0.1", free_tcp_port)
    try:
        async with serving(broker, "gone", tmp_path):
            pass
        await publish(broker, "adaptdrive/no drive/state", "{}", "-r")
        await publish(broker, "adaptdrive/broken/state", "[]", "-r")
        await publish(broker, "adaptdrive/remembered/availability", "online", "-r")
        await publish(broker, "adaptdrive/remembered/state", '{"state": "running"}', "-r")
        async with (
            serving(broker, "alpha", tmp_path) as alpha,
            serving(broker, "beta", tmp_path) as beta,
        ):
            beta.host.trip("over-voltage: v_bst = 431 V, limit 430 V")
            async with listening(broker, beta.topic("state")) as ear:
                await ear.until(lambda message: "tripped" in message.payload)
            asking = asyncio.create_task(adaptdrive("list", *at(broker)))
            while not asking.done():
                for one in (alpha, beta):
                    one.hub.publish(drive_report(600))
                await asyncio.sleep(0.05)
            outcome = await asking
            found = json.loads((await adaptdrive("list", "--json", *at(broker))).output)
    finally:
        stop_process(process)
    assert (outcome.status, outcome.errors) == (0, "")
    head, *rows = outcome.output.splitlines()
    assert head.split()[:3] == ["drive", "state", "output"]
    *rows, doubt, advice = rows
    assert doubt.startswith("remembered is online by the broker, but no telemetry came")
    assert advice.startswith("beta: what to do: ")
    assert [row.split()[:2] for row in rows] == [
        ["beta", "tripped"],
        ["alpha", "standby"],
        ["gone", "offline"],
        ["remembered", "running"],
    ]
    assert rows[3].startswith("remembered  running (last known)  -")
    assert "  3.1 V  " in rows[1]
    assert rows[0].endswith("over-voltage: v_bst = 431 V, limit 430 V")
    assert found.keys() == {"alpha", "beta", "gone", "remembered"}
    assert found["beta"]["state"]["last_trip"]["remedy"]


async def test_a_broker_without_drives_ends_with_3(
    mosquitto_launcher: MosquittoLauncher, free_tcp_port: int
) -> None:
    process = mosquitto_launcher.start(free_tcp_port)
    try:
        outcome = await adaptdrive("list", "--broker", f"127.0.0.1:{free_tcp_port}")
    finally:
        stop_process(process)
    assert outcome.status == 3
    assert "no drive is on 127.0.0.1" in outcome.errors


async def test_a_reply_as_json_keeps_the_exit_status(mosquitto: Broker, tmp_path: Path) -> None:
    async with serving(mosquitto, "programs", tmp_path) as bench:
        accepted = await adaptdrive("setpoint", "programs", "3", "--json", *at(mosquitto))
        refused = await adaptdrive("setpoint", "programs", "9", "--json", *at(mosquitto))
    assert (accepted.status, refused.status) == (0, 1)
    assert json.loads(accepted.output)["accepted"] is True
    assert "outside" in json.loads(refused.output)["reason"]
    assert bench.host.asked == [SetSetpoint(3.0)]


async def test_the_configuration_names_the_broker(mosquitto: Broker, tmp_path: Path) -> None:
    file = tmp_path / "motor.toml"
    file.write_text(motor_configuration(mosquitto.port, 1, {}), encoding="utf-8")
    async with serving(mosquitto, "configured", tmp_path):
        outcome = await adaptdrive("enable", "configured", "--config", str(file))
    assert (outcome.status, outcome.errors) == (0, "")


def test_options_go_before_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "motor.toml"
    changes = {
        "mqtt.host": '"site"',
        "mqtt.tls": "true",
        "mqtt.ca_file": '"ca.crt"',
        "mqtt.username": '"motor"',
    }
    path.write_text(motor_configuration(8884, 1, changes), encoding="utf-8")
    plain = Contact(config=path).settings
    assert (plain.host, plain.port, plain.tls) == ("site", 8884, True)
    assert plain.ca_file == tmp_path / "ca.crt"
    assert plain.username is None
    own = Contact(config=path, broker="desk", username="operator").settings
    assert (own.host, own.port, own.tls, own.ca_file) == ("desk", 1883, False, None)
    assert own.username == "operator"


@pytest.mark.parametrize(
    ("contact", "place"),
    [
        (Contact(), ("127.0.0.1", 1883, False)),
        (Contact(tls=True), ("127.0.0.1", 8883, True)),
        (Contact(broker="[::1]:99"), ("::1", 99, False)),
        (Contact(broker="desk", tls=True), ("desk", 8883, True)),
    ],
)
def test_the_usual_broker(contact: Contact, place: tuple[str, int, bool]) -> None:
    settings = contact.settings
    assert (settings.host, settings.port, settings.tls) == place


def test_an_unusable_configuration_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="motor"):
        _ = Contact(config=tmp_path / "motor.toml").settings


async def test_completion_knows_the_commands(tmp_path: Path) -> None:
    words = ("--install-completion", "--shell", "bash", "--output", str(tmp_path / "done"))
    outcome = await adaptdrive(*words)
    assert outcome.status == 0
    text = (tmp_path / "done").read_text(encoding="utf-8")
    assert all(word in text for word in ("setpoint", "list", "--broker"))
