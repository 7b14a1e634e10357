"""The reference page of the configuration, made from the models that validate it.

`python -m tools.pages.reference_page FILE` writes the page.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from adaptdrive.config.root import Configuration

Schema = Mapping[str, Any]

_INTRODUCTION = """\
# Configuration

For those who write the configuration of a drive: every key, its type, limits and default. One TOML
file describes one drive. Numbers are in SI units; a unit that could be mistaken is part of the key.
`adaptdrive check` lists every error with its place; an unknown key is an error. Texts are single
lines of at most 4096 characters.

A file must have {required}; the other sections have defaults throughout. [Hardware](hardware.md)
explains how to describe a drive. `make docs` writes this page from `src/adaptdrive/config`.
"""
_REPEATED = 2
"""Rows of earlier sections from which on they are named in a sentence."""
_HEAD = "| key | type | default | meaning |\n|---|---|---|---|"
_TYPES = {
    "array": "list",
    "boolean": "boolean",
    "integer": "integer",
    "number": "float",
    "object": "table",
    "string": "string",
}
_BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}


def reference_page() -> str:
    """Describe every key of the configuration in Markdown, one table for each section."""
    schema = Configuration.model_json_schema()
    required = ", ".join(f"`[{name}]`" for name in schema["required"])
    definitions = schema["$defs"]
    sections = dict.fromkeys(_sections(schema, definitions))
    parts = [_INTRODUCTION.format(required=required)]
    places: dict[str, str] = {}
    parts += [_section(definitions[name], places) for name in sections]
    return "\n".join(parts)


def _sections(schema: Schema, definitions: Schema) -> Iterator[str]:
    """Names of the sections below a section, in the order of its keys, depth first."""
    for key in schema["properties"].values():
        for name in _references(key):
            yield name
            yield from _sections(definitions[name], definitions)


def _references(key: Schema) -> Iterator[str]:
    nested, items = key.get("additionalProperties", {}), key.get("items", {})
    choices = [*key.get("anyOf", ()), *key.get("oneOf", ()), *items.get("oneOf", ())]
    for option in [key, *choices, nested]:
        if "$ref" in option:
            yield option["$ref"].removeprefix("#/$defs/")


def _section(schema: Schema, places: dict[str, str]) -> str:
    """One section: rows that an earlier one has are named in a sentence, with its title."""
    title, _, meaning = schema["description"].rstrip(".").partition(": ")
    meaning = f"\n{meaning[0].upper()}{meaning[1:]}.\n" if meaning else ""
    required = schema.get("required", ())
    rows = [
        _row(name, key, required=name in required)
        for name, key in schema["properties"].items()
        if not (_is_section(key) or "const" in key)  # the title has the one value of such a key
    ]
    known = [row for row in rows if places.setdefault(row, title) != title]
    told = [_repeated(known, places)] if len(known) >= _REPEATED else []
    shown = [row for row in rows if not told or row not in known]
    table = [_HEAD, *shown, ""] if shown else []
    return "\n".join([f"## {title}", meaning, *told, *table])


def _repeated(rows: Sequence[str], places: Mapping[str, str]) -> str:
    """Sentences with the keys of the rows, one for each section that has them."""
    keys: dict[str, list[str]] = {}
    for row in rows:
        keys.setdefault(places[row], []).append(row.split(" | ")[0].removeprefix("| "))
    return "".join(f"As in {title}: {', '.join(names)}.\n" for title, names in keys.items())


def _is_section(key: Schema) -> bool:
    if "oneOf" in key.get("items", ()):
        return True
    return not {"$ref", "oneOf"}.isdisjoint(key) or "$ref" in key.get("additionalProperties", ())


def _row(name: str, key: Schema, *, required: bool) -> str:
    default = "required" if required else _default(key["default"])
    cells = (f"`{name}`", _type(key), default, key.get("description", ""))
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _default(value: object) -> str:
    return "none" if value is None else f"`{json.dumps(value)}`"


def _type(key: Schema) -> str:
    if "anyOf" in key:
        return " or ".join(_type(option) for option in key["anyOf"] if option.get("type") != "null")
    if "$ref" in key:
        return "table"
    choices = key.get("enum", [key["const"]] if "const" in key else [])
    if choices:
        return ", ".join(f"`{json.dumps(choice)}`" for choice in choices)
    return ", ".join([_kind(key), *_limits(key)])


def _kind(key: Schema) -> str:
    return "path" if key.get("format") == "path" else _TYPES[key["type"]]


def _limits(key: Schema) -> Iterator[str]:
    if "pattern" in key:
        yield f"`{key['pattern']}`"
    low, high = key.get("minimum"), key.get("maximum")
    if low is not None and high is not None:
        yield f"{low:g}…{high:g}"
        return
    for bound, sign in _BOUNDS.items():
        if bound in key and (bound != "exclusiveMinimum" or low is None):
            yield f"{sign} {key[bound]:g}"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference_page(), encoding="utf-8")
