"""Reading of payloads with care: every client that may publish decides what they hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

_LARGEST = 1e100
"""Least number that no quantity has: sums and differences of smaller ones are numbers still."""


def part(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a part of a payload that is an object; empty where it is missing or something else.

    Every client of the broker that may publish there decides what a payload holds.
    """
    found = content.get(name)
    return found if isinstance(found, dict) else {}


def number(value: object) -> float:
    """Return a number in a payload as a float, NaN for anything else and where it is too large."""
    if not isinstance(value, int | float) or not abs(value) < _LARGEST:
        return math.nan
    return float(value)


def printable(value: object) -> str:
    """Return a part of a payload as text without characters that command a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(value))


def unconfirmed_stop(state: Mapping[str, Any]) -> str:
    """Return the value of `stop` for a stop that the drive has not confirmed, empty for none.

    A drive may be energised then although it is commanded off.

    Args:
        state: Payload of `state`.
    """
    word = state.get("stop")
    return "" if word is None or word == "confirmed" else printable(word)
