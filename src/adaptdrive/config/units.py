"""Units that a signal may be in, and what they are in SI."""

from __future__ import annotations

import math
from typing import Literal

Unit = Literal[
    "V", "A", "W", "K", "rad/s", "mV", "kV", "mA", "kA", "kW", "degC", "degF", "rpm", "Hz"
]

_IN_SI: dict[str, tuple[float, float]] = {
    "mV": (1e-3, 0.0),
    "kV": (1e3, 0.0),
    "mA": (1e-3, 0.0),
    "kA": (1e3, 0.0),
    "kW": (1e3, 0.0),
    "degC": (1.0, 273.15),
    "degF": (5.0 / 9.0, 459.67 * 5.0 / 9.0),
    "rpm": (math.pi / 30.0, 0.0),
    "Hz": (2.0 * math.pi, 0.0),
    **dict.fromkeys(("V", "A", "W", "K", "rad/s"), (1.0, 0.0)),
}


def in_si(table: dict[str, object]) -> dict[str, object]:
    """The table of a file with scale and offset that lead to SI; its own lead to its `unit`.

    A table whose entries are of the wrong kind is left as it is, for its own checks to refuse.

    Args:
        table: `unit`, and perhaps `scale` and `offset`.
    """
    unit, scale, offset = table.get("unit"), table.get("scale", 1.0), table.get("offset", 0.0)
    if not (isinstance(unit, str) and unit in _IN_SI and _is_number(scale) and _is_number(offset)):
        return table
    factor, zero = _IN_SI[unit]
    return {**table, "scale": factor * float(scale), "offset": factor * float(offset) + zero}  # type: ignore[arg-type]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
