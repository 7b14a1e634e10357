"""The published contract: current, complete, and true of what a daemon sends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.control.signals import Shape, Waveform
from adaptdrive.mqtt.commands import FORMS
from adaptdrive.runtime.reports import Event, Severity, State
from adaptdrive.safety.trips import TripKind
from tests.unit.mqtt.contract import validators
from tests.unit.mqtt.memory_broker import MemoryBroker
from tests.unit.mqtt.peers import (
    HEALTH,
    OVER_VOLTAGE,
    STANDBY,
    Heard,
    drive_report,
    listening,
    load_report,
    publish,
    serving,
)
from tools.pages.asyncapi import documents, schema
from tools.pages.topic_table import Topic, topics

FOLDER = Path(__file__).parents[3] / "docs" / "mqtt"
VALIDATORS = validators()
SELF_EXPLAINING = {"p50", "p99", "max", "value", "std"}


def test_the_published_files_are_current() -> None:
    made = documents()
    assert {path.name for path in FOLDER.iterdir()} == set(made), "run `make docs`"
    for name, text in made.items():
        assert (FOLDER / name).read_text(encoding="utf-8") == text, f"{name}: run `make docs`"


@pytest.mark.parametrize("topic", [one for one in topics() if one.sent], ids=lambda one: one.name)
def test_each_key_of_a_message_is_explained(topic: Topic) -> None:
    for found in schema(topic)["$defs"].values():
        for name, described in found.get("properties", {}).items():
            assert described.get("description") or name in SELF_EXPLAINING, name


def test_every_verb_has_a_topic() -> None:
    assert {f"command/{verb}" for verb in FORMS} <= VALIDATORS.keys()


async def test_every_message_of_a_service_fits_its_schema(
    broker: MemoryBroker, tmp_path: Path
) -> None:
    async with (
        listening(broker, "adaptdrive/strict/#") as ear,
        serving(broker, "strict", tmp_path) as bench,
    ):
        wave = Waveform(Shape.SINE, 1.0, 2.0, 60.0)
        bench.host.show(replace(STANDBY, state=State.RUNNING, waveform=wave))
        bench.host.trip(OVER_VOLTAGE)
        bench.hub.publish(load_report(7))
        bench.hub.publish(HEALTH)
        bench.hub.publish(drive_report(840))
        bench.hub.publish(replace(drive_report(0), measurement=None, age_s=float("nan")))
        bench.hub.publish(Event("trip", Severity.ALARM, "slow loop", 1, TripKind.SLOW_LOOP))
        for payload in ("", "{}", '{"id": 7}', '{"id": "a", "value": 1}'):
            await publish(broker, bench.topic("command/setpoint"), payload)
        await publish(broker, bench.topic("ask/history"), "")
        wanted = {topic.name for topic in topics() if topic.sent}

        def judge(message: Heard) -> bool:
            name = message.topic.removeprefix("adaptdrive/strict/")
            if name.partition("/")[0] not in {"command", "ask"}:
                content = message.payload if name == "availability" else message.content
                VALIDATORS[name].validate(content)
            wanted.discard(name)
            return not wanted

        await ear.until(judge)
