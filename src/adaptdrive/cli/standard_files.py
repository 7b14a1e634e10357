"""Standard input, output and error of a process that was started without some of them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from io import TextIOWrapper
from typing import Literal, TextIO

_INPUT, _OUTPUT, _ERRORS = range(3)
_FEWEST_COLUMNS = 20
_HELP = {"--help", "-h"}


def open_standard_files() -> None:
    """Open the null device in place of each standard file that is closed.

    Otherwise a bus or a database would get that number, and what other code prints would end in it.
    """
    for number in (_INPUT, _OUTPUT, _ERRORS):
        if not _is_open(number):
            os.open(os.devnull, os.O_RDWR)  # the kernel gives the lowest free number
    sys.stdin = sys.stdin or _stream(_INPUT, "r")
    sys.stdout = sys.stdout or _stream(_OUTPUT, "w")
    sys.stderr = sys.stderr or _stream(_ERRORS, "w")
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        # Latin-1 has no "…": what a terminal cannot show is escaped, as it is on standard error
        sys.stdout.reconfigure(errors="backslashreplace")


def lay_out_help(arguments: Sequence[str]) -> None:
    """Have help laid out for so many columns at least that the layout of its tables ends.

    Args:
        arguments: Words after the program's name.
    """
    given = os.environ.get("COLUMNS", "")
    columns = int(given[:6]) if given.isdecimal() else shutil.get_terminal_size().columns
    if columns < _FEWEST_COLUMNS and not _HELP.isdisjoint(arguments or ["--help"]):
        os.environ["COLUMNS"] = str(_FEWEST_COLUMNS)


def discard_output() -> None:
    """Discard output that nothing takes, which would be an error at the exit of Python."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def _stream(number: int, mode: Literal["r", "w"]) -> TextIO:
    return open(number, mode, encoding="utf-8", closefd=False)
