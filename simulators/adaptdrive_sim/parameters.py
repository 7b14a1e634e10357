"""Parameters that describe themselves: meaning, unit and range; and the example configurations.

A plant's parameters are a frozen dataclass whose fields are made with `quantity`. Description,
unit and range travel in the field's metadata; `check_quantities` holds values against them.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptdrive.util.errors import AdaptdriveError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

EXAMPLES = Path(__file__).resolve().parent / "examples"
"""Folder of the example configurations that come with the simulator."""

SEED_MAX = 2**63 - 1
"""Largest seed that numpy and a column of a table both take."""


class ParameterError(AdaptdriveError):
    """A parameter of a simulated plant lies outside its range."""


def quantity(default: float, unit: str, description: str, low: float, high: float) -> Any:  # noqa: ANN401 - a field
    """Make a dataclass field that carries its own documentation and range.

    Args:
        default: Value when none is given, in `unit`.
        unit: Its usual notation; empty for a pure number.
        description: What the parameter means.
        low: Smallest legal value.
        high: Largest legal value.

    Returns:
        The field, of any type: a number of the class to type checkers, a field to mypyc.
    """
    metadata = {"unit": unit, "description": description, "low": low, "high": high}
    return field(default=default, metadata=metadata)


def check_quantities(parameters: DataclassInstance) -> None:
    """Hold every quantity of a parameter dataclass against its range.

    Raises:
        ParameterError: The first value that is not finite or lies outside its range.
    """
    for one in fields(parameters):
        if own := one.metadata:
            place, value = f"{type(parameters).__name__}.{one.name}", getattr(parameters, one.name)
            check_range(place, value, own["low"], own["high"], own["unit"])


def check_range(place: str, value: float, low: float, high: float, unit: str) -> None:
    """Refuse a value that is not finite or lies outside `low`…`high`.

    Raises:
        ParameterError: Names the place, the value and the range.
    """
    if not (math.isfinite(value) and low <= value <= high):
        rule = f"must lie in {low:g}…{high:g} {unit}".rstrip()
        raise ParameterError(f"{place} = {value!r} {rule}")


def example_tables(name: str) -> dict[str, Any]:
    """The tables of one example configuration."""
    return tomllib.loads((EXAMPLES / name).read_text(encoding="utf-8"))
