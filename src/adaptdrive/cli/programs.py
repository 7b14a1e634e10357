"""Times and slopes as people write them: `2 h`, `1.5/min`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import cyclopts
from cyclopts import Parameter

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def per_second(text: str) -> float:
    """Return a slope per second from text such as `2/s`, `1.5/min` or `20/h`.

    Raises:
        ValueError: It is none.
    """
    number, slash, unit = text.partition("/")
    return _positive(number, text, "2/s, 1.5/min or 20/h") / _unit(unit, slash, text)


def _positive(number: str, text: str, such_as: str) -> float:
    """Return the number of a text that has one, finite and above 0."""
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f'"{text}" is not a positive number with its unit, such as {such_as}.')
    return value


def _unit(unit: str, mark: str, text: str) -> float:
    """Return the seconds of a unit; one that is left out is the second."""
    name = unit.strip() if mark else "s"
    if name not in _SECONDS:
        raise ValueError(f'"{text}" has none of the units {", ".join(_SECONDS)}.')
    return _SECONDS[name]


def _read_slope(_: object, tokens: Sequence[cyclopts.Token]) -> float:
    return per_second(tokens[0].value)


Slope = Annotated[float, Parameter(converter=_read_slope)]
