"""Memory layout of an object in compiled code.

A `Layout` is made from a live object: every number is one word of eight bytes, a list or tuple of
numbers as many words, an object inside an object lies inside it, and so do the objects of a list
that have one layout, one behind the other. Lengths are thus known when code
is compiled for a layout, and no memory has to be managed. Functions and absent (None) parts are
part of the layout itself. Anything else (texts, generators, dictionaries) is left out: compiled
code cannot ask for it.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Hashable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["float", "int", "bool", "floats", "ints", "object", "objects", "function"]

_SCALARS: dict[type, Kind] = {float: "float", int: "int", bool: "bool"}


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute.

    Attributes:
        name: Its name.
        kind: What it is.
        offset: Its first word.
        length: How many entries it has.
        part: Layout of an object, or of each object of a list.
        function: Module and name of a function.
    """

    name: str
    kind: Kind
    offset: int
    length: int = 1
    part: Layout | None = None
    function: tuple[str, str] = ("", "")


@dataclass(frozen=True, slots=True)
class Layout:
    """An object's class and attributes.

    Attributes:
        module: Module of the class.
        name: Name of the class.
        fields: Its attributes.
        words: Its size in words.
        absent: True for the layout of something that is None.
    """

    module: str
    name: str
    fields: tuple[Attribute, ...]
    words: int
    absent: bool = False

    def find(self, name: str) -> Attribute | None:
        """The attribute of that name."""
        return next((field for field in self.fields if field.name == name), None)


def layout_of(instance: Any) -> Layout:
    """The layout of an object and everything in it."""
    hints = _hints(instance.__class__)
    fields: list[Attribute] = []
    words = 0
    for name, value in _attributes(instance):
        field = _field(name, value, hints.get(name), words)
        if field is not None:
            fields.append(field)
            words += _size(field)
    return Layout(type(instance).__module__, type(instance).__name__, tuple(fields), words)


def write(layout: Layout, instance: Any, words: NDArray[np.int64]) -> None:
    """Copy an object's numbers to their places in memory."""
    floats = words.view(np.float64)
    for field in layout.fields:
        value = getattr(instance, field.name)
        place = slice(field.offset, field.offset + _size(field))
        match field.kind:
            case "float":
                floats[field.offset] = value
            case "floats":
                floats[place] = value
            case "int" | "bool":
                words[field.offset] = int(value)
            case "ints":
                words[place] = value
            case "object" if field.part is not None and not field.part.absent:
                write(field.part, value, words[place])
            case "objects" if field.part is not None:
                for entry, own in zip(value, words[place].reshape(len(value), -1), strict=True):
                    write(field.part, entry, own)
            case _:
                pass


def _field(name: str, value: Any, hint: Any, offset: int) -> Attribute | None:
    if value is None:
        optional = _optional_class(hint)
        part = _absent(optional) if optional is not None else None
        return None if part is None else Attribute(name, "object", offset, part=part)
    scalar = _SCALARS.get(hint) or _SCALARS.get(type(value))
    if scalar is not None or isinstance(value, int):
        return Attribute(name, scalar or "int", offset)
    if isinstance(value, list | tuple):
        return _sequence(name, value, hint, offset)
    if isinstance(value, types.FunctionType):
        return Attribute(name, "function", offset, function=(value.__module__, value.__qualname__))
    if _is_ours(value):
        return Attribute(name, "object", offset, part=layout_of(value))
    return None


def _is_ours(value: Any) -> bool:
    package = type(value).__module__.partition(".")[0]
    known = dataclasses.is_dataclass(value) or package in {"adaptdrive", "adaptdrive_sim"}
    return known and not isinstance(value, Enum)


def _sequence(
    name: str, value: list[Any] | tuple[Any, ...], hint: Any, offset: int
) -> Attribute | None:
    if value and all(_is_ours(entry) for entry in value):
        part, *others = {layout_of(entry) for entry in value}
        return None if others else Attribute(name, "objects", offset, len(value), part)
    if not all(isinstance(entry, int | float) for entry in value):
        return None
    whole = value and all(isinstance(entry, int) for entry in value)
    kind: Kind = "ints" if whole and float not in typing.get_args(hint) else "floats"
    return Attribute(name, kind, offset, length=len(value))


def _absent(cls: type) -> Layout:
    """Return the stand-in for a missing object in code that is never reached."""
    hints = _hints(cls)
    fields: list[Attribute] = []
    for field in dataclasses.fields(cls):
        kind = _SCALARS.get(hints[field.name])
        if kind is not None:
            fields.append(Attribute(field.name, kind, len(fields)))
    return Layout(cls.__module__, cls.__name__, tuple(fields), len(fields), absent=True)


def _optional_class(hint: Any) -> type | None:
    known = [one for one in typing.get_args(hint) if isinstance(one, type)]
    candidates = [one for one in known if dataclasses.is_dataclass(one)]
    return candidates[0] if len(candidates) == 1 else None


def _size(field: Attribute) -> int:
    if field.part is not None:
        return field.part.words * field.length
    return 0 if field.kind == "function" else field.length


@cache
def _hints(cls: Hashable) -> dict[str, Any]:
    return typing.get_type_hints(cls) if dataclasses.is_dataclass(cls) else {}


def _attributes(instance: Any) -> list[tuple[str, Any]]:
    if dataclasses.is_dataclass(instance):
        return [
            (field.name, getattr(instance, field.name)) for field in dataclasses.fields(instance)
        ]
    return list(vars(instance).items())
