"""The tables of a TOML file before they are a configuration."""

from __future__ import annotations

import contextlib
import math
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from adaptdrive.config.root import Configuration

_LARGEST = 1e12
"""No quantity in SI units, factor or bound is larger, or smaller than its inverse."""

_INTEGER_BITS = 64
_SHOWN_TEXT = 80
_LONGEST_TEXT = 4096
"""The longest path of Linux. Names and units go into every message of telemetry."""
_DEEPEST = 20
_CONTROLS = frozenset({"Cc", "Zl", "Zp"})
"""Unicode's categories of control characters and of the separators of lines and paragraphs."""

Keys = tuple[int | str, ...]


class Absurd(NamedTuple):
    """An implausible value: its message, and the keys that lead to it."""

    keys: Keys
    message: str


def value_flaws(value: object, keys: Keys = ()) -> Iterator[Absurd]:
    """Find numbers that nothing has, and texts and keys that no screen, log or topic can show.

    Args:
        value: A table, a list or a value of the file.
        keys: Where it stands.
    """
    if len(keys) > _DEEPEST:
        yield Absurd(keys, f"more than {_DEEPEST} tables lie in each other")
    elif isinstance(value, dict):
        for key, one in value.items():
            yield from _text_flaws(key, "the key", (*keys, key)) or value_flaws(one, (*keys, key))
    elif isinstance(value, list):
        for number, one in enumerate(value):
            yield from value_flaws(one, (*keys, number))
    elif isinstance(value, str):
        yield from _text_flaws(value, "the text", keys)
    else:
        yield from _number_flaws(value, keys)


def _text_flaws(text: str, what: str, keys: Keys) -> list[Absurd]:
    if len(text) > _LONGEST_TEXT:
        rule = f"have at most {_LONGEST_TEXT} characters"
    elif any(unicodedata.category(one) in _CONTROLS for one in text):
        rule = "be one line without control characters"
    else:
        return []
    return [Absurd(keys, f"{what} must {rule} (it is {shortened(repr(text))})")]


def _number_flaws(value: object, keys: Keys) -> Iterator[Absurd]:
    if isinstance(value, float) and not math.isfinite(value):
        yield Absurd(keys, f"must be a finite number (it is {value})")
    elif isinstance(value, float) and value and not 1.0 / _LARGEST <= abs(value) <= _LARGEST:
        problem = f"its size must be from {1.0 / _LARGEST:g} to {_LARGEST:g}, in SI units"
        yield Absurd(keys, f"{problem} (it is {value})")
    elif isinstance(value, int) and value.bit_length() >= _INTEGER_BITS:
        yield Absurd(keys, f"has more than {_INTEGER_BITS} bits")


def without(tables: dict[str, Any], places: Iterable[Keys]) -> dict[str, Any]:
    """Return a copy of tables that lacks some keys.

    Args:
        tables: The tables.
        places: Where the keys stand; one that is not there is missing already, and one within a
            list of values stands for the list.
    """
    marked = frozenset(place[:-1] if isinstance(place[-1], int) else place for place in places)
    copy = _copied(tables, (), marked)
    assert isinstance(copy, dict)  # noqa: S101 - of a dict
    return copy


def _copied(value: object, keys: Keys, marked: frozenset[Keys]) -> object:
    if isinstance(value, dict):
        return {
            key: _copied(one, (*keys, key), marked)
            for key, one in value.items()
            if (*keys, key) not in marked
        }
    if isinstance(value, list):
        return [_copied(one, (*keys, number), marked) for number, one in enumerate(value)]
    return value


def valid_sections(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the sections of a configuration that are valid each by itself, defaults included.

    Args:
        tables: By name.
        folder: That from which relative paths are taken.
    """
    found = {}
    for name, field in Configuration.model_fields.items():
        if name in tables:
            section: Any = Annotated[field.annotation, field]
            with contextlib.suppress(ValidationError):
                found[name] = TypeAdapter(section).validate_python(tables[name], context=folder)
        elif not field.is_required():
            found[name] = field.get_default(call_default_factory=True)
    return found


def shortened(text: str) -> str:
    """Return a text without its middle, where it is long."""
    half = _SHOWN_TEXT // 2
    return text if len(text) <= _SHOWN_TEXT else f"{text[:half]}…{text[-half:]}"
