"""Payloads for people: read with care, as every client may publish, and names of estimates."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import Any

from adaptdrive.quantity import BOOST, Given

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


def given_in(state: Mapping[str, Any]) -> Given:
    """Return what a drive is commanded, and gives, from the payload of `state`."""
    found = part(state, "manipulated")
    return Given(*(printable(found.get(name, getattr(BOOST, name))) for name in ("name", "unit")))


def unconfirmed_stop(state: Mapping[str, Any]) -> str:
    """Return the value of `stop` for a stop that the drive has not confirmed, empty for none.

    A drive may be energised then although it is commanded off.

    Args:
        state: Payload of `state`.
    """
    word = state.get("stop")
    return "" if word is None or word == "confirmed" else printable(word)


_UNIT = re.compile(r"(.+?)_((?:s|V|A|W|K|S|J|F|Ohm|rad)\d?(?:_per_(?:s|V|A|W|K)\d?)?)")
_WRITTEN = (("_per_", "/"), ("2", "²"), ("Ohm", "Ω"))
_BATH = "resistance_K_per_W"


def is_known(estimate: Mapping[str, Any]) -> bool:
    """Return whether an estimate is larger than two of its standard deviations.

    Args:
        estimate: Its `value` and `std`; one without a deviation counts as known.
    """
    return not 2.0 * number(estimate.get("std")) >= abs(number(estimate.get("value")))


def quantity_and_unit(
    name: str, names: Collection[str], output_unit: str, given_unit: str = "V"
) -> tuple[str, str]:
    """Return the quantity that an estimate is, and its unit.

    Args:
        name: Name of the estimate, such as `tau_sum_s`.
        names: Names of all estimates of the load: an offset has the unit of the load's input.
        output_unit: Unit of the output, of which a gain is so much for each unit of the input.
        given_unit: Unit of what the drive gives, which is the input of a motor.
    """
    if name == "gain":
        one = f"({output_unit})" if "/" in output_unit else output_unit or "1"
        return name, f"{one}/{given_unit}" if given_unit else output_unit
    if name == "input_offset":
        return "input offset", "W" if _BATH in names else given_unit
    match = _UNIT.fullmatch(name)
    if match is None:
        return name.replace("_", " "), ""
    unit = match[2]
    for word, sign in _WRITTEN:
        unit = unit.replace(word, sign)
    return match[1].replace("_", " "), unit
