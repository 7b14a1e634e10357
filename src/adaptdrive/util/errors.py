"""All errors of adaptdrive: one root, and leaves that carry their data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

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


class BusError(AdaptdriveError):
    """A bus cannot be opened or has been lost."""

    def __init__(self, bus: str, problem: str) -> None:
        self.bus = bus
        self.problem = problem
        super().__init__(f"{bus}: {problem}")


class RefusedError(AdaptdriveError):
    """An operator's command was not carried out; the reason is the message."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class RecordingError(AdaptdriveError):
    """A recorded session cannot be written or read."""

    def __init__(self, session: Path | str, problem: str) -> None:
        self.session = session
        self.problem = problem
        super().__init__(f"{session}: {problem}")


class CommissionError(AdaptdriveError):
    """An experiment on a load cannot continue; the reason is the message."""


class IdentificationError(AdaptdriveError):
    """Data do not determine a load; the reason is the message."""


def first_error(group: BaseExceptionGroup[_Error]) -> _Error:
    """Return the error to report: tasks end together, and the first error is the cause."""
    error = group.exceptions[0]
    return first_error(error) if isinstance(error, BaseExceptionGroup) else error
