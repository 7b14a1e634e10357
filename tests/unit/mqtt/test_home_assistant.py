"""The device in Home Assistant: its templates, rendered on real messages."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import jinja2
import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.mqtt.commands import Payload
from adaptdrive.mqtt.contract import Output, encode
from adaptdrive.mqtt.service import discovery
from adaptdrive.runtime.requests import Disable, Enable, Request, Reset, SetMode, SetSetpoint
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.quantity import Given
from tests.unit.mqtt.contract import validators
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import (
    HEALTH,
    OVER_VOLTAGE,
    ask,
    drive_report,
    listening,
    load_report,
    profile,
    publish,
    serving,
)

TOPIC = "homeassistant/device/adaptdrive-{}/config"


ANY = {"platform", "name", "unique_id", "device_class", "enabled_by_default", "qos"}
ANY |= {"json_attributes_topic", "json_attributes_template"}
READ = {"state_topic", "value_template"}
WRITTEN = {"command_topic", "command_template"}
DOCUMENTED = {  # keys that must be there, and those that may, by the manual of each platform
    "sensor": ({"state_topic"}, READ | {"unit_of_measurement", "state_class", "options"}),
    "binary_sensor": ({"state_topic"}, READ),
    "button": ({"command_topic"}, WRITTEN),
    "select": ({"command_topic", "options"}, READ | WRITTEN | {"options"}),
    "number": (
        {"command_topic"},
        READ | WRITTEN | {"min", "max", "step", "mode", "unit_of_measurement"},
    ),
}
CLASS_UNITS: dict[
    str | None, set[str | None]
] = {  # units that Home Assistant takes for a class of a sensor
    "voltage": {"V", "mV", "µV", "kV", "MV"},
    "current": {"A", "mA"},
    "temperature": {"°C", "°F", "K"},
    "temperature_delta": {"°C", "°F", "K"},
    "power": {"W", "kW", "mW", "MW"},
    "frequency": {"Hz", "kHz", "MHz", "GHz"},
    "duration": {"s", "min", "h"},
    "enum": {None},
    "problem": {None},
    None: {None, "rad/s", "%", "Nm"},
}
COMMANDS = [
    ("setpoint", "3.1", SetSetpoint(3.1)),
    ("mode", "adaptive", SetMode(Mode.ADAPTIVE)),
    ("stop", "", Disable()),
    ("reset", "", Reset()),
    ("enable", "", Enable()),
]


def rendered(template: str, *, at: datetime | None = None, **names: Any) -> str:
    """Render a template as Home Assistant does, which has a zone of its own."""
    then = at or datetime.now(UTC)
    names |= {"now": lambda: then.astimezone(ZoneInfo("Europe/Berlin")), "utcnow": lambda: then}
    names |= {"timedelta": timedelta}
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined)  # no HTML
    return environment.from_string(template).render(names)


async def test_the_device_is_announced_only_where_it_is_wanted(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with serving(broker, "plain", tmp_path):
        pass
    async with (
        listening(broker, "homeassistant/#") as ear,
        serving(broker, "wanted", tmp_path, home_assistant="homeassistant"),
    ):
        found = await ear.on(TOPIC.format("wanted"))
    async with listening(broker, "homeassistant/#") as late:
        assert (await late.on(found.topic)).retained
        await publish(broker, "homeassistant/end", "{}")
        await late.on("homeassistant/end")
    assert [message.topic for message in late.heard] == [found.topic, "homeassistant/end"]
    assert found.content["device"]["identifiers"] == ["adaptdrive-wanted"]
    assert found.content["availability_topic"] == "adaptdrive/wanted/availability"
    ids = [one["unique_id"] for one in found.content["components"].values()]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("age_s", [0, 5])
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command[0])
async def test_only_a_stop_of_home_assistant_acts_late(
    broker: MemoryBroker, tmp_path: Path, command: tuple[str, str, Request], age_s: float
) -> None:
    """Its client sends again, after any time, what a loss of the broker has left unacknowledged."""
    name, value, request_ = command
    component = discovery(profile("late"), "homeassistant")[1]["components"][name]
    verb = component["command_topic"].rpartition("/")[2]
    given = datetime.now(UTC) - timedelta(seconds=age_s)
    payload = rendered(component["command_template"], at=given, value=value)
    validators()[f"command/{verb}"].validate(json.loads(payload))
    async with serving(broker, "late", tmp_path) as bench:
        reply = await ask(bench, verb, payload)
    acts = name == "stop" or not age_s
    assert (reply["accepted"], bench.host.asked) == (acts, [request_] if acts else [])
    assert reply["reason"].startswith("" if acts else "expired at ")


def test_commands_of_home_assistant_expire_alike_when_summer_time_ends() -> None:
    component = discovery(profile("x"), "homeassistant")[1]["components"]["enable"]
    for minutes in range(0, 180, 10):
        given = datetime(2026, 10, 25, tzinfo=UTC) + timedelta(minutes=minutes)
        payload = Payload(rendered(component["command_template"], at=given).encode())
        assert payload.request("enable") == (Enable(), given + timedelta(seconds=5))


async def test_what_home_assistant_shows_is_in_the_messages(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    payload = json.loads(encode(discovery(profile("shown"), "homeassistant")[1]))
    async with (
        serving(broker, "shown", tmp_path) as bench,
        listening(broker, bench.topic("#")) as ear,
    ):
        bench.hub.publish(load_report(7))
        load = await ear.on(bench.topic("telemetry/load"))
        bench.hub.publish(drive_report(9))
        drive = await ear.on(bench.topic("telemetry/drive"))
        bench.host.trip(OVER_VOLTAGE)
        tripped = await ear.until(lambda message: '"tripped"' in message.payload)
        refused = await ask(bench, "setpoint", '{"id": "ha-1", "value": 9}')
    contents = {one.topic: one.content for one in (load, drive, tripped)}
    contents[bench.topic("reply")] = refused
    shown = {}
    for name, component in payload["components"].items():
        if "state_topic" in component:
            content = contents[component["state_topic"]]
            shown[name] = rendered(component["value_template"], value_json=content)
    assert shown == {
        "output": "3.1",
        "boost_reference": "302.0",
        "applied": "300.5",
        "state": "tripped",
        "controller": "fixed",
        "tripped": "ON",
        "mode": "fixed",
        "setpoint": "0.0",
        "refused": f"setpoint: {refused['reason']}",
        "trip_kind": "over-voltage",
        "last_trip": OVER_VOLTAGE.text,
        "program": "none",
        "program_left": "None",
    }
    program = {"name": "bath", "text": "bath running, step 3 of 5: hold"}
    for name, content, wanted in (
        ("program", {"program": program}, "bath running, step 3 of 5: hold"),
        ("program_left", {"remaining_s": 9200.0}, "9200.0"),
    ):
        template = payload["components"][name]["value_template"]
        assert rendered(template, value_json=content) == wanted
    kind = payload["components"]["trip_kind"]
    assert rendered(kind["value_template"], value_json={"trip_kind": None}) == "none"
    assert kind["options"] == ["none", *(one.value for one in TripKind)]
    attributes = payload["components"]["last_trip"]["json_attributes_template"]
    assert "remedy" in json.loads(rendered(attributes, value_json=tripped.content))
    assert rendered(attributes, value_json={"last_trip": None}) == "{}"


@pytest.mark.parametrize("unit", ["V", "A", "°C", "K", "rad/s", "%", "Hz", "Nm", "kW", ""])
def test_each_key_is_one_that_home_assistant_documents(unit: str) -> None:
    known = replace(profile("x"), output=Output("output", unit), manipulated=Given("drawn", unit))
    message = json.loads(encode(discovery(known, "homeassistant")[1]))
    assert message.keys() == {"device", "origin", "availability_topic", "qos", "components"}
    assert message["device"].keys() == {"identifiers", "name", "manufacturer", "sw_version"}
    for component in message["components"].values():
        needed, allowed = DOCUMENTED[component["platform"]]
        assert needed | {"unique_id"} <= component.keys() <= allowed | ANY
        if component["platform"] in ("sensor", "binary_sensor"):
            kind = component.get("device_class")
            assert component.get("unit_of_measurement") in CLASS_UNITS[kind]
            assert ("options" in component) == (kind == "enum")
            assert not ("options" in component and "state_class" in component)


async def test_the_health_of_a_load_is_retained_and_shown(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    known = replace(profile("worn"), quantities=("friction", "inertia", "damping"))
    components = json.loads(encode(discovery(known, "homeassistant")[1]))["components"]
    async with (
        serving(broker, "worn", tmp_path) as bench,
        listening(broker, bench.topic("#")) as ear,
    ):
        bench.hub.publish(HEALTH)
        live = await ear.on(bench.topic("health"))
        async with listening(broker, bench.topic("health")) as late:
            retained = await late.on(bench.topic("health"))
    validators()["health"].validate(live.content)
    assert retained.retained
    assert retained.content == live.content
    shown = {
        name: rendered(one["value_template"], value_json=live.content)
        for name, one in components.items()
        if one.get("state_topic") == live.topic
    }
    assert shown == {
        "health": "ON",
        "health-friction": "21.0",
        "health-inertia": "21.0",
        "health-damping": "None",
    }
    attributes = components["health-friction"]["json_attributes_template"]
    found = json.loads(rendered(attributes, value_json=live.content))
    assert (found["trend_percent"], found["trend_std"]) == (1.0, 0.04)
    assert {*components["health-friction"]} <= DOCUMENTED["sensor"][1] | ANY


async def test_a_broker_that_was_started_again_has_the_health_again(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with serving(broker, "worn", tmp_path) as bench:
        bench.hub.publish(HEALTH)
        async with listening(broker, bench.topic("health")) as ear:
            first = await ear.on(bench.topic("health"))
        broker.kill()
        broker.restart()
        async with listening(broker, bench.topic("health")) as late:
            assert (await late.on(bench.topic("health"))).content == first.content


def test_the_answer_to_another_client_changes_no_refusal() -> None:
    template = discovery(profile("x"), "homeassistant")[1]["components"]["refused"][
        "value_template"
    ]
    refused = {"id": "ha-1", "verb": "enable", "accepted": False, "reason": "tripped"}
    before = {"state": "enable: tripped"}
    for answer, shown in (
        (refused, "enable: tripped"),
        (refused | {"accepted": True}, "none"),
        (refused | {"id": 7, "accepted": True}, before["state"]),
        (refused | {"id": None, "verb": "mode"}, before["state"]),
    ):
        assert rendered(template, value_json=answer, this=before) == shown


def test_a_narrow_range_has_a_step_that_home_assistant_takes() -> None:
    narrow = replace(profile("x"), limits={"setpoint": (0.0, 0.5)})
    number = discovery(narrow, "homeassistant")[1]["components"]["setpoint"]
    assert number["step"] == 1e-3  # it leaves a control with a smaller one out


def test_enabling_from_home_assistant_must_be_switched_on_there() -> None:
    components = discovery(profile("x"), "homeassistant")[1]["components"]
    hidden = [name for name, one in components.items() if one.get("enabled_by_default") is False]
    assert hidden == ["enable"]
