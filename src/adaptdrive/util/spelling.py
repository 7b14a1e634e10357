"""Names that were probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]
Place = tuple[str, ...]
Pair = tuple[Place, Place]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint at the known name that is like a wrong one; empty where none is."""
    close = difflib.get_close_matches(name, [*known], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def key_proposal(schema: Schema, location: Place, place: Place) -> str:
    """Return a hint at the key that an unknown one was probably meant to be.

    Args:
        schema: JSON Schema of the configuration.
        location: Keys and union tags that lead to the unknown key, as pydantic locates it.
        place: Keys alone that lead to it; another kind of load may have that key.
    """
    known, key = [*_keys(schema, schema, (), ())], place[-1]
    hint = nearest(key, [one[-1] for one, _ in known if _is_beside(one, location)])
    if hint:
        return hint
    named = (one for _, one in known if one[-1] == key and "*" not in one and one != place)
    elsewhere = next(named, None)
    return f" (did you mean {'.'.join(elsewhere)}?)" if elsewhere else ""


def _keys(whole: Schema, schema: Schema, location: Place, place: Place) -> Iterator[Pair]:
    """Every key: as pydantic locates it, and its place; `*` stands for any name or number."""
    schema = whole["$defs"][schema["$ref"].removeprefix("#/$defs/")] if "$ref" in schema else schema
    for key, below in schema.get("properties", {}).items():
        found = (*location, key), (*place, key)
        yield found
        yield from _keys(whole, below, *found)
    for kind, reference in schema.get("discriminator", {}).get("mapping", {}).items():
        yield from _keys(whole, {"$ref": reference}, (*location, kind), place)
    for option in schema.get("anyOf", ()):
        yield from _keys(whole, option, location, place)
    for below in (schema.get("additionalProperties"), schema.get("items")):
        if isinstance(below, Mapping):
            yield from _keys(whole, below, (*location, "*"), (*place, "*"))


def _is_beside(known: Place, location: Place) -> bool:
    """Return whether a key is one of the section in which another one stands."""
    pairs = zip(known[:-1], location, strict=False)
    return len(known) == len(location) and all(one in ("*", other) for one, other in pairs)
