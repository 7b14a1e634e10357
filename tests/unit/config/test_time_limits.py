"""No limit of time is so long that it is none."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from adaptdrive.config import Configuration

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
    options = [key, *key.get("anyOf", ()), key.get("additionalProperties", {})]
    assert any("maximum" in option or "exclusiveMaximum" in option for option in options)
