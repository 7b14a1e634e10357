"""Configurations of monitoring programs: run by the program itself, or held to the contract."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib
from pathlib import Path
from typing import Any

from adaptdrive.mqtt.contract import NO_TRIP
from adaptdrive.runtime.reports import EVENT_KINDS
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.trends import HealthQuantity
from tools.pages.asyncapi import schema
from tools.pages.topic_table import topics

FOLDER = Path(__file__).parents[3] / "deploy" / "monitoring"
EXPORTER = FOLDER / "prometheus-mqtt-exporter.yaml"


def keys(name: str) -> set[str]:
    """Names of all numbers and texts of a message, with those of nested objects behind dots."""
    topic = next(one for one in topics() if one.name == name)
    document = schema(topic)
    found = set()

    def visit(part: dict[str, Any], prefix: str) -> None:
        if "$ref" in part:
            part = document["$defs"][part["$ref"].rpartition("/")[2]]
        for key, value in part.get("properties", {}).items():
            found.add(f"{prefix}{key}")
            visit(value, f"{prefix}{key}.")

    visit(document, "")
    return found


PUBLISHED = keys("telemetry/load") | keys("telemetry/drive")


def test_the_exporter_reads_keys_that_are_published() -> None:
    wanted = set(re.findall(r"mqtt_name: (\S+)", EXPORTER.read_text(encoding="utf-8")))
    assert len(wanted) > 10
    assert {key for key in wanted if not key.startswith("bus.")} <= PUBLISHED


def trip_numbers() -> dict[str, int]:
    """Return the number of each kind of trip, as the exporter publishes it."""
    _, _, mapped = EXPORTER.read_text(encoding="utf-8").partition("      map:\n")
    pairs = re.findall(r"^        ([a-z-]+): (\d+)$", mapped, re.MULTILINE)
    return {kind: int(number) for kind, number in pairs}


def test_the_exporter_has_a_number_of_its_own_for_each_kind_of_trip() -> None:
    numbers = trip_numbers()
    assert numbers.keys() == {NO_TRIP, *(kind.value for kind in TripKind)}
    assert len(set(numbers.values())) == len(numbers)
    assert numbers[NO_TRIP] == 0


def test_telegraf_reads_topics_and_keys_that_are_published() -> None:
    document = tomllib.loads((FOLDER / "telegraf.conf").read_text(encoding="utf-8"))
    known = {topic.address.replace("{drive}", "+") for topic in topics() if topic.sent}
    kept = {f"adaptdrive_{name}": keys(name) for name in ("event", "state", "health")}
    for source in document["inputs"]["mqtt_consumer"]:
        assert set(source["topics"]) <= known
        published = kept.get(source["name_override"], PUBLISHED)
        assert {*source["json_string_fields"], *source["tag_keys"]} <= published
        assert source["json_time_key"] in published


def test_telegraf_has_the_client_name_of_no_drive() -> None:
    """A broker would end the connection of a drive of that name, which trips."""
    document = tomllib.loads((FOLDER / "telegraf.conf").read_text(encoding="utf-8"))
    names = [one["client_id"] for one in document["inputs"]["mqtt_consumer"]]
    assert len(set(names)) == len(names) > 1
    assert not any(re.fullmatch("adaptdrive-[A-Za-z0-9_-]+", name) for name in names)


def test_the_dashboard_shows_fields_that_telegraf_stores() -> None:
    dashboard = json.loads((FOLDER / "grafana-dashboard.json").read_text(encoding="utf-8"))
    targets = [target for panel in dashboard["panels"] for target in panel["targets"]]
    targets += [one["target"] for one in dashboard["annotations"]["list"]]
    queries = [target["query"] for target in targets]
    fields = {field for query in queries for field in re.findall(r'r\._field == "(\w+)"', query)}
    flat = {key.replace(".", "_") for key in PUBLISHED | keys("event") | keys("state")}
    assert fields
    assert {field for field in fields if not field.startswith("estimates_")} <= flat
    assert any("quantities_.*_change_percent" in query for query in queries)
    assert "change_percent" in {one.name for one in dataclasses.fields(HealthQuantity)}
    telegraf = tomllib.loads((FOLDER / "telegraf.conf").read_text(encoding="utf-8"))
    stored = {one["name_override"] for one in telegraf["inputs"]["mqtt_consumer"]}
    assert {
        name for one in queries for name in re.findall(r'_measurement == "(\w+)"', one)
    } == stored
    # both messages have the output: drawn from both, it would be two lines
    sources = [re.findall(r'"(\w+)" and r._field == "output"', query) for query in queries]
    assert [source for source in sources if source] == [["drive"]]
    assert sum('r.kind == "trip"' in query for query in queries) == 1
    assert "trip" in EVENT_KINDS
