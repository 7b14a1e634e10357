"""The tables of a TOML file before they are a configuration."""

from __future__ import annotations

import contextlib
import math
import unicodedata
from collections.abc import Iterator
from typing import Any

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

Problem = tuple[Keys, str]
"""An implausible value: the keys that lead to it, and what is said of it."""


def value_flaws(value: object, keys: Keys = ()) -> Iterator[Problem]:
    """Find numbers that nothing has, and texts and keys that no screen, log or topic can show.

    Args:
        value: A table, a list or a value of the file.
        keys: Where it stands.
    """
    if len(keys) > _DEEPEST:
        yield keys, f"more than {_DEEPEST} tables lie in each other"
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


def _text_flaws(text: str, what: str, keys: Keys) -> list[Problem]:
    if len(text) > _LONGEST_TEXT:
        rule = f"have at most {_LONGEST_TEXT} characters"
    elif any(unicodedata.category(one) in _CONTROLS for one in text):
        rule = "be one line without control characters"
    else:
        return []
    return [(keys, f"{what} must {rule} (it is {shortened(repr(text))})")]


def _number_flaws(value: object, keys: Keys) -> Iterator[Problem]:
    if isinstance(value, float) and not math.isfinite(value):
        yield keys, f"must be a finite number (it is {value})"
    elif isinstance(value, float) and value and not 1.0 / _LARGEST <= abs(value) <= _LARGEST:
        problem = f"its size must be from {1.0 / _LARGEST:g} to {_LARGEST:g}, in SI units"
        yield keys, f"{problem} (it is {value})"
    elif isinstance(value, int) and value.bit_length() >= _INTEGER_BITS:
        yield keys, f"has more than {_INTEGER_BITS} bits"


def take_out(tables: Any, place: Keys) -> None:  # noqa: ANN401 - or a list of them
    """Take a value out of tables; one within a list of values stands for the list.

    Args:
        tables: The tables, which are changed.
        place: The keys that lead to it; where they lead nowhere, nothing is done.
    """
    *above, last = place[:-1] if isinstance(place[-1], int) else place
    with contextlib.suppress(LookupError, TypeError, AttributeError):
        for key in above:
            tables = tables[key]
        tables.pop(last, None)


def shortened(text: str) -> str:
    """Return a text without its middle, where it is long."""
    half = _SHOWN_TEXT // 2
    return text if len(text) <= _SHOWN_TEXT else f"{text[:half]}…{text[-half:]}"
