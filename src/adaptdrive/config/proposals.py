"""Names that were probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

Schema = Mapping[str, Any]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint at the known name that is like a wrong one; empty where none is."""
    close = difflib.get_close_matches(name, [*known], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def key_proposal(schema: Schema, section: Sequence[str], place: Sequence[str]) -> str:
    """Return a hint at the key that an unknown one was probably meant to be.

    Args:
        schema: JSON Schema of the configuration.
        section: Keys and union tags that lead to the section, as pydantic locates it.
        place: Keys that lead to the unknown one, and it; another kind of load may have that key.
    """
    own, key = tuple(place), place[-1]
    here = _below(schema, schema, section)
    hint = nearest(key, here)
    if hint:
        return hint
    elsewhere = [one for one in _places(schema, schema, ()) if one[-1] == key and one != own]
    return f" (did you mean {'.'.join(elsewhere[0])}?)" if elsewhere else ""


def _below(whole: Schema, schema: Schema, section: Sequence[str]) -> set[str]:
    """Keys of a section."""
    found: set[str] = set()
    for one in _options(whole, schema):
        keys, kinds = one.get("properties", {}), one.get("discriminator", {}).get("mapping", {})
        if not section:
            found.update(keys)
            continue
        name, *rest = section
        kind = {"$ref": kinds[name]} if name in kinds else None
        items = one.get("items") if name.isdigit() else None
        for part in (keys.get(name), one.get("additionalProperties"), items, kind):
            if isinstance(part, Mapping):
                found |= _below(whole, part, rest)
    return found


def _options(whole: Schema, schema: Schema) -> Iterator[Schema]:
    """A schema and all that it may stand for."""
    yield schema
    if "$ref" in schema:
        yield from _options(whole, whole["$defs"][schema["$ref"].removeprefix("#/$defs/")])
    for option in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from _options(whole, option)


def _places(whole: Schema, schema: Schema, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Every key of the sections that have a fixed name."""
    for one in _options(whole, schema):
        for key, below in one.get("properties", {}).items():
            yield (*path, key)
            yield from _places(whole, below, (*path, key))
