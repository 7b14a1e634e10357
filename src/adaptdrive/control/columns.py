"""Columns: the fields of a fast tick and of a slow step, as published, recorded and documented.

A field is declared once, in its dataclass, with its unit and its meaning. The MQTT message, the
recorded row, the Arrow schema and the page `docs/columns.md` are made from that declaration.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, is_dataclass
from enum import StrEnum
from functools import cache
from operator import attrgetter
from typing import Any, TypeVar, get_origin, get_type_hints

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Quantity:
    """The annotation of a field that is a column.

    Attributes:
        unit: Unit: a symbol, `y` for the unit of the output, `u` for that of the load's input,
            `v` for that of what the drive is commanded, and gives, or an empty string for a plain
            number or a text.
        meaning: What the value is.
        name: Name of the column where the field's own is not unique.
    """

    unit: str
    meaning: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """One column.

    Attributes:
        name: Its name in messages and on disk.
        kind: `float`, `int`, `bool`, `str`, `tuple` (of floats) or `dict` (estimates by name).
        unit: Unit, as in `Quantity`.
        meaning: What the value is.
        source: Path of the field in the report.
        read: Takes the value from a report.
        choices: All values that it can have, none where it can have any.
    """

    name: str
    kind: type
    unit: str
    meaning: str
    source: str
    read: Callable[[Any], Any]
    choices: tuple[str, ...] = ()


def columns_of(report: type, path: str = "") -> tuple[Column, ...]:
    """Return the columns of a report: its own fields, and those of the dataclasses in it."""
    columns: list[Column] = []
    for name, (kind, quantity) in _fields(report).items():
        place = f"{path}{name}"
        if is_dataclass(kind):
            columns += columns_of(kind, f"{place}.")
        elif quantity is not None:
            choices = tuple(kind) if issubclass(kind, StrEnum) else ()
            label, stored = quantity.name or name, str if choices else kind
            about = (quantity.unit, quantity.meaning, place)
            columns.append(Column(label, stored, *about, attrgetter(place), choices))
    return tuple(columns)


def rebuild(report: Callable[..., T], row: dict[str, Any]) -> T:
    """Return the report of which a row holds the columns."""
    values: dict[str, Any] = {}
    for name, (kind, quantity) in _fields(report).items():
        if quantity is not None:
            values[name] = kind(row[quantity.name or name])
        elif is_dataclass(kind):
            values[name] = rebuild(kind, row)
    return report(**values)


@cache
def _fields(report: Hashable) -> dict[str, tuple[type, Quantity | None]]:
    """Return type and annotation of each field by its name."""
    plain, annotated = get_type_hints(report), get_type_hints(report, include_extras=True)
    return {
        name: (get_origin(hint) or hint, _quantity(annotated[name])) for name, hint in plain.items()
    }


def _quantity(hint: Any) -> Quantity | None:  # noqa: ANN401 - any annotation
    found = getattr(hint, "__metadata__", ())
    return next((one for one in found if isinstance(one, Quantity)), None)
