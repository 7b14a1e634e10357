"""No limit of time is so long that it is none."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from adaptdrive.config import Configuration
from tests.config import modbus_documents
from tests.config.documents import flaws
from tests.config.test_sensors import DIFFERENCE, THERMOCOUPLES
from tests.config.test_sensors import flaws as sensor_flaws

TIME = re.compile(r".*(?<!_per)_(s|us|ticks|cycles|periods)$")
NO_LIMITS = {
    "tau_motor_s": "of a model",
    "tau_filter_s": "of a model",
    "tau_s": "of a model",
    "relaxation_s": "of a model",
    "tau_lambda_s": "of a filter",
    "lag_s": "of a model",
    "latency_ticks": "below one slow period",
    "cycle_s": "at most one slow period",
    "stale_s of a sensor bus": "at most ten cycles",
}
"""Times that limit nothing, or are limited by other keys."""


def times() -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Section, name and schema of each time in the configuration."""
    for section, schema in Configuration.model_json_schema()["$defs"].items():
        for name, key in schema.get("properties", {}).items():
            known = {name, f"{name} of a sensor bus" if "Sensor" in section else name}
            if TIME.match(name) and known.isdisjoint(NO_LIMITS):
                yield section, name, key


@pytest.mark.parametrize(("section", "name", "key"), list(times()))
def test_each_limit_of_time_has_an_end(section: str, name: str, key: Mapping[str, Any]) -> None:
    options = [key, *key.get("anyOf", ())]
    assert any("maximum" in option or "exclusiveMaximum" in option for option in options)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("interlocks__stale_s", "50.0"),
        ("interlocks__stale_s", "2.1"),
        ("interlocks__stuck_s", "1e6"),
        ("interlocks__precharge_timeout_s", "1e6"),
        ("bus__stale_cycles", "11.0"),
        ("bus__clock_ticks", "121"),
        ("supervisor__response_s", "1e6"),
    ],
)
def test_a_limit_that_is_none_is_refused(key: str, value: str) -> None:
    found = flaws(**{key: value})
    assert key.replace("__", ".") in found
    assert "less than or equal to" in found[key.replace("__", ".")]


@pytest.mark.parametrize(("cycle_s", "stale_s"), [("0.25", "2.6"), ("0.25", "60.0")])
def test_a_sensor_that_is_silent_for_long_is_refused(cycle_s: str, stale_s: str) -> None:
    sensors = THERMOCOUPLES.replace("cycle_s = 0.25", f"cycle_s = {cycle_s}\nstale_s = {stale_s}")
    assert "must not exceed 2.5 s" in sensor_flaws(sensors + DIFFERENCE)["sensor_bus.0.stale_s"]


def test_a_poll_of_a_minute_is_refused() -> None:
    assert "bus.poll_ticks" in modbus_documents.flaws(bus__poll_ticks="7200")
