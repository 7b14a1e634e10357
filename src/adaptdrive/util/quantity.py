"""Quantities: the columns that leave the process, and the words for what a drive is commanded.

A field of a report is declared once, in its dataclass, with its unit and its meaning. The MQTT
message, the recorded row, the Arrow schema and the page `docs/columns.md` are made from that
declaration.

What a drive is commanded, and gives, is its boost voltage, or what a key names: texts, topics,
columns and figures take its name and unit from here, and the unit in which people see the output.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, is_dataclass, replace
from enum import StrEnum
from functools import cache
from operator import attrgetter
from types import UnionType
from typing import Any, Self, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")

MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
"""What a drive or its sensors measure, by name."""

# Columns: the fields of a fast tick and of a slow step, as published, recorded and documented.


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
        if quantity is not None:
            choices = tuple(kind) if issubclass(kind, StrEnum) else ()
            is_text = bool(choices) or is_dataclass(kind)
            label, stored = quantity.name or name, str if is_text else kind
            about = (quantity.unit, quantity.meaning, place)
            read = _text_getter(place) if is_dataclass(kind) else attrgetter(place)
            columns.append(Column(label, stored, *about, read, choices))
        elif is_dataclass(kind):
            columns += columns_of(kind, f"{place}.")
    return tuple(columns)


def _text_getter(place: str) -> Callable[[Any], str]:
    """Return what reads a field as text, empty for None."""
    read = attrgetter(place)

    def text(report: Any) -> str:  # noqa: ANN401 - any report
        value = read(report)
        return "" if value is None else str(value)

    return text


def rebuild(report: Callable[..., T], row: dict[str, Any]) -> T:
    """Return the report of which a row holds the columns."""
    values: dict[str, Any] = {}
    for name, (kind, quantity) in _fields(report).items():
        if quantity is not None:
            stored = row[quantity.name or name]
            values[name] = getattr(kind, "parse", kind)(stored)
        elif is_dataclass(kind):
            values[name] = rebuild(kind, row)
    return report(**values)


@cache
def _fields(report: Hashable) -> dict[str, tuple[type, Quantity | None]]:
    """Return type and annotation of each field by its name."""
    plain, annotated = get_type_hints(report), get_type_hints(report, include_extras=True)
    return {name: (_kind(hint), _quantity(annotated[name])) for name, hint in plain.items()}


def _kind(hint: Any) -> type:  # noqa: ANN401 - any annotation
    """Return the class of an annotation, without its parameters and without None."""
    origin = get_origin(hint)
    found: type = get_args(hint)[0] if origin is UnionType else origin or hint
    return found


def _quantity(hint: Any) -> Quantity | None:  # noqa: ANN401 - any annotation
    found = getattr(hint, "__metadata__", ())
    return next((one for one in found if isinstance(one, Quantity)), None)


# The words for what a drive is commanded, and gives.

BOOST_VOLTAGE = "v_bst"
"""Name of what a power stage gives that nothing else is said of."""


@dataclass(frozen=True, slots=True)
class Given:
    """Name and unit of what a drive is commanded, and gives.

    Attributes:
        name: Its name, such as `frequency`.
        unit: Its unit; empty for a plain number.
    """

    name: str = BOOST_VOLTAGE
    unit: str = "V"

    @property
    def is_boost_voltage(self) -> bool:
        """True for the voltage of a boost stage, which is there before the load is fed."""
        return self.name == BOOST_VOLTAGE

    @property
    def title(self) -> str:
        """Its name for people."""
        return "boost voltage" if self.is_boost_voltage else self.name

    @property
    def asked(self) -> str:
        """Label of its commanded value."""
        return "V_c" if self.is_boost_voltage else f"{self.name} asked for"

    @property
    def by_hand(self) -> str:
        """Name of its value in mode manual."""
        return "voltage" if self.is_boost_voltage else self.name

    @property
    def symbol(self) -> str:
        """Its commanded value in a sentence."""
        return "V_c" if self.is_boost_voltage else self.name

    @property
    def axis(self) -> str:
        """Label of an axis of a figure."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: float, form: str = ".4g") -> str:
        """Return a value with its unit.

        Args:
            value: In the unit.
            form: How the number is written.
        """
        return f"{value:{form}} {self.unit}".rstrip()


BOOST = Given()
"""The voltage of a boost stage."""


# The unit in which people see and type the output.


@dataclass(frozen=True, slots=True)
class Display:
    """Unit in which people see and type the output; control, records and telemetry keep its own.

    Attributes:
        unit: Its name, empty for a plain number.
        scale: Its units for each unit of the output, above 0.
        offset: Its value where the output is 0.
    """

    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0

    @property
    def change(self) -> Self:
        """The same for differences, such as a slope or a tolerance."""
        return replace(self, offset=0.0)

    @property
    def mark(self) -> str | None:
        """Unit that a command names which holds typed values; None where they need none."""
        return None if (self.scale, self.offset) == (1.0, 0.0) else self.unit

    def shown(self, value: float) -> float:
        """Return a value of the output as people see it."""
        return self.scale * value + self.offset

    def typed(self, value: float) -> float:
        """Return the value of the output that people have typed."""
        return (value - self.offset) / self.scale

    def text(self, value: float, form: str = "g") -> str:
        """Return a value of the output with the unit.

        Args:
            value: In the unit of the output.
            form: How the number is written.
        """
        return f"{self.shown(value):{form}} {self.unit}".rstrip()

    def range_text(self, low: float, high: float, form: str = "g") -> str:
        """Return a range of the output with the unit, arguments as of `text`."""
        return f"{self.shown(low):{form}}…{self.text(high, form)}"
