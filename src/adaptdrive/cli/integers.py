"""Integers on a command line, never rounded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from cyclopts import Parameter, Token, convert


def _read(_: object, tokens: Sequence[Token]) -> int:
    """Read an integer; cyclopts alone rounds a fraction without a word."""
    text = tokens[0].value
    if text.partition(".")[2].strip("0"):
        raise ValueError(f'unable to convert "{text}" into int.')
    number: int = convert(int, tokens)
    return number


Integer = Annotated[int, Parameter(converter=_read)]
