"""Options that several commands have, what they refuse, and the form of what they print."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter, Token, convert

from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive.util.files import directory_flaw


def _check_finite(_: object, number: float | None) -> None:
    """Refuse infinity and what is no number."""
    if number is not None and not math.isfinite(number):
        raise ValueError("A finite number is needed.")


def _read_integer(_: object, tokens: Sequence[Token]) -> int:
    """Read an integer; cyclopts alone rounds a fraction without a word."""
    text = tokens[0].value
    if text.partition(".")[2].strip("0"):
        raise ValueError(f'unable to convert "{text}" into int.')
    number: int = convert(int, tokens)
    return number


Flag = Annotated[bool, Parameter(negative=())]
Json = Annotated[bool, Parameter(name="--json", negative=())]
Settings = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
Number = Annotated[float, Parameter(validator=_check_finite)]
Second = Annotated[float | None, Parameter(validator=_check_finite)]
Integer = Annotated[int, Parameter(converter=_read_integer)]


def print_json(content: object) -> None:
    """Print something as JSON, for programs."""
    print(msgspec.json.format(msgspec.json.encode(content)).decode())


@contextmanager
def extra(name: str) -> Iterator[None]:
    """End the command where a library is missing that belongs to an extra of the package.

    Args:
        name: The extra.
    """
    try:
        yield
    except ModuleNotFoundError as problem:
        advice = f"{problem.name} is missing: pip install 'adaptdrive[{name}]'"
        sys.exit(f"adaptdrive: {advice}")


def refuse_unwritable(folder: Path) -> None:
    """Refuse a folder that takes no file, before anything long is begun; make a missing one.

    Args:
        folder: The folder that the result goes to.

    Raises:
        ConfigurationError: It cannot be made or written.
    """
    if (flaw := directory_flaw(folder)) is not None:
        raise ConfigurationError("--into", [Flaw(str(folder), f"cannot be written: {flaw}")])
