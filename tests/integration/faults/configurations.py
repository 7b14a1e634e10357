"""Configurations drawn from the schema: any values of any keys that the validation accepts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

from hypothesis import strategies as st

from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.util.errors import ConfigurationError
from tests.integration.faults.course import example, example_path

Place = tuple[str, ...]
Tables = dict[str, Any]

_SCHEMA = Configuration.model_json_schema()
_SECTIONS: Mapping[str, Any] = _SCHEMA["$defs"]
_DRAWN = ("drive", "voltage_loop", "load", "estimator", "supervisor", "interlocks")
_FIXED = {"line_frequency_Hz", "where"}
"""Keys of which the simulated drive has to have the same value."""

_DECADES = 4.0
"""Powers of ten by which a number is moved at most."""


@st.composite
def configurations(draw: st.DrawFn, name: str) -> Tables:
    """Draw the tables of a valid configuration, from the example that has a name of `FILES`."""
    tables = example(name)
    keys = list(_keys(_SCHEMA, tables, ()))
    for place, key in draw(st.lists(st.sampled_from(keys), min_size=1, max_size=12)):
        changed = _with(tables, place, draw(_values(key, _value(tables, place))))
        if _is_valid(changed, name):
            tables = changed
    return tables


def _is_valid(tables: Tables, name: str) -> bool:
    try:
        validate_configuration(tables, example_path(name))
    except ConfigurationError:
        return False
    return True


def _keys(
    section: Mapping[str, Any], tables: Tables, place: Place
) -> Iterator[tuple[Place, Mapping[str, Any]]]:
    """Keys of a section and of those below it, as far as values can be drawn for them."""
    for name, key in section["properties"].items():
        if place or name in _DRAWN:
            below = _section(key, tables.get(name, {}))
            if below is not None:
                yield from _keys(below, tables.get(name, {}), (*place, name))
            elif name not in _FIXED and any(_is_drawn(one) for one in _options(key)):
                yield (*place, name), key


def _section(key: Mapping[str, Any], tables: Tables) -> Mapping[str, Any] | None:
    """Return the section that a key stands for; None for a value."""
    reference = key.get("$ref")
    if "discriminator" in key:
        reference = key["discriminator"]["mapping"][tables["type"]]
    for option in _options(key):
        reference = reference or option.get("$ref")
    return None if reference is None else _SECTIONS[reference.removeprefix("#/$defs/")]


def _options(key: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [key, *key.get("anyOf", ())]


def _is_drawn(key: Mapping[str, Any]) -> bool:
    return "enum" in key or key.get("type") in ("boolean", "integer", "number")


def _value(tables: Tables, place: Place) -> Any:
    """Return the value at a place, None where there is none."""
    for name in place[:-1]:
        tables = tables.get(name, {})
    return tables.get(place[-1])


def _with(tables: Tables, place: Place, value: object) -> Tables:
    changed = deepcopy(tables)
    section = changed
    for name in place[:-1]:
        section = section.setdefault(name, {})
    section[place[-1]] = value
    return changed


def _values(key: Mapping[str, Any], old: Any) -> st.SearchStrategy[Any]:
    """Values of a key: each choice, its ends, and what is near and far from its present value."""
    drawn = next(one for one in _options(key) if _is_drawn(one))
    present = key.get("default") if old is None else old
    if "enum" in drawn:
        return st.sampled_from(drawn["enum"])
    if drawn["type"] == "boolean":
        return st.booleans()
    numbers = _numbers(drawn, float(present or 1.0))
    return numbers.map(round) if drawn["type"] == "integer" else numbers


def _numbers(key: Mapping[str, Any], present: float) -> st.SearchStrategy[float]:
    ends = [key[end] for end in ("minimum", "maximum") if end in key]
    ends += [key["exclusiveMinimum"] + 1e-3] if "exclusiveMinimum" in key else []
    low, high = key.get("minimum", -math.inf), key.get("maximum", math.inf)
    moved = st.floats(-_DECADES, _DECADES).map(lambda power: present * 10.0 ** (power**3 / 16.0))
    return st.one_of(
        st.sampled_from([0.0, *(float(end) for end in ends)]),
        moved.map(lambda value: float(min(max(value, low), high))),
    )
