"""All errors of adaptdrive: one root, leaves with their data, names that were probably meant."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar

import msgspec

# All errors of adaptdrive: one root, and leaves that carry their data.

NOT_JSON = (msgspec.DecodeError, UnicodeError, RecursionError)
"""Errors of a decoder for bytes or text that are no JSON or MessagePack of the type asked for."""


_Error = TypeVar("_Error", bound=Exception)


def escaped(text: str) -> str:
    """Return a text in which bytes of a file's name that are not UTF-8 are escaped."""
    return text.encode(errors="backslashreplace").decode()


def reason_of(problem: OSError) -> str:
    """Return the words of an error of the system, without its number and its file."""
    return problem.strerror or str(problem)


class AdaptdriveError(Exception):
    """Root of every error that adaptdrive raises on purpose."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """One error in a configuration: its place and its description."""

    place: str
    message: str

    def __str__(self) -> str:
        text = f"{self.place}: {self.message}"
        return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)


class ConfigurationError(AdaptdriveError):
    """A configuration cannot be used; lists every error found, not just the first."""

    def __init__(self, source: Path | str, flaws: Sequence[Flaw]) -> None:
        self.source = source
        self.flaws = tuple(flaws)
        super().__init__("\n".join(f"{source}: {flaw}" for flaw in self.flaws))

    @classmethod
    def of(cls, source: Path | str, place: str, message: str) -> Self:
        """Return the error of one flaw."""
        return cls(source, [Flaw(place, message)])


class PlacedError(AdaptdriveError):
    """An error of one bus, session or drive: its message begins with the name of that.

    Attributes:
        problem: What is wrong, without the name.
    """

    def __init__(self, place: Path | str, problem: str) -> None:
        self.problem = problem
        super().__init__(f"{place}: {problem}")


class BusError(PlacedError):
    """A bus cannot be opened or has been lost."""


class RefusedError(AdaptdriveError):
    """An operator's command was not carried out; the message is the reason, and the remedy.

    Attributes:
        kind: Kind of the trip for which it was not, empty for any other reason.
        remedy: Steps that remove the cause of that trip, empty where none is known.
    """

    def __init__(self, reason: str, kind: str = "", remedy: str = "") -> None:
        self.reason = reason
        self.kind = kind
        self.remedy = remedy
        super().__init__(f"{reason}\nwhat to do: {remedy}" if remedy else reason)


class RecordingError(PlacedError):
    """A recorded session cannot be written or read."""


class CommissionError(AdaptdriveError):
    """An experiment on a load cannot continue; the reason is the message."""


class IdentificationError(AdaptdriveError):
    """Data do not determine a load; the reason is the message."""


def first_error(group: BaseExceptionGroup[_Error]) -> _Error:
    """Return the error to report: tasks end together, and the first error is the cause."""
    error = group.exceptions[0]
    return first_error(error) if isinstance(error, BaseExceptionGroup) else error


# Names that were probably meant.

Schema = Mapping[str, Any]
Place = tuple[str, ...]
Pair = tuple[Place, Place]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint at the known name that is like a wrong one; empty where none is."""
    close = difflib.get_close_matches(name, [*known], n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def key_proposal(schema: Schema, location: Place, place: Place) -> str:
    """Return a hint at the key that an unknown one was probably meant to be.

    Args:
        schema: JSON Schema of the configuration.
        location: Keys and union tags that lead to the unknown key, as pydantic locates it.
        place: Keys alone that lead to it; another kind of load may have that key.
    """
    known, key = [*_keys(schema, schema, (), ())], place[-1]
    hint = nearest(key, [one[-1] for one, _ in known if _is_beside(one, location)])
    if hint:
        return hint
    named = (one for _, one in known if one[-1] == key and "*" not in one and one != place)
    elsewhere = next(named, None)
    return f" (did you mean {'.'.join(elsewhere)}?)" if elsewhere else ""


def _keys(whole: Schema, schema: Schema, location: Place, place: Place) -> Iterator[Pair]:
    """Every key: as pydantic locates it, and its place; `*` stands for any name or number."""
    schema = whole["$defs"][schema["$ref"].removeprefix("#/$defs/")] if "$ref" in schema else schema
    for key, below in schema.get("properties", {}).items():
        found = (*location, key), (*place, key)
        yield found
        yield from _keys(whole, below, *found)
    for kind, reference in schema.get("discriminator", {}).get("mapping", {}).items():
        yield from _keys(whole, {"$ref": reference}, (*location, kind), place)
    for option in schema.get("anyOf", ()):
        yield from _keys(whole, option, location, place)
    for below in (schema.get("additionalProperties"), schema.get("items")):
        if isinstance(below, Mapping):
            yield from _keys(whole, below, (*location, "*"), (*place, "*"))


def _is_beside(known: Place, location: Place) -> bool:
    """Return whether a key is one of the section in which another one stands."""
    pairs = zip(known[:-1], location, strict=False)
    return len(known) == len(location) and all(one in ("*", other) for one, other in pairs)
