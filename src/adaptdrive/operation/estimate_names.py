"""Names of estimates for people: the quantity, and its unit apart from it."""

from __future__ import annotations

import re
from collections.abc import Collection

_UNIT = re.compile(r"(.+?)_((?:s|V|A|W|K|S|J|F|Ohm|rad)\d?(?:_per_(?:s|V|A|W|K)\d?)?)")
_WRITTEN = (("_per_", "/"), ("2", "²"), ("Ohm", "Ω"))
_BATH = "resistance_K_per_W"


def quantity_and_unit(name: str, names: Collection[str], output_unit: str) -> tuple[str, str]:
    """Return the quantity that an estimate is, and its unit.

    Args:
        name: Name of the estimate, such as `tau_sum_s`.
        names: Names of all estimates of the load: an offset has the unit of the load's input.
        output_unit: Unit of the output, of which a gain is so much for each volt.
    """
    if name == "gain":
        return name, _per_volt(output_unit)
    if name == "input_offset":
        return "input offset", "W" if _BATH in names else "V"
    match = _UNIT.fullmatch(name)
    if match is None:
        return name.replace("_", " "), ""
    unit = match[2]
    for word, sign in _WRITTEN:
        unit = unit.replace(word, sign)
    return match[1].replace("_", " "), unit


def _per_volt(unit: str) -> str:
    return f"({unit})/V" if "/" in unit else f"{unit or '1'}/V"
