"""Columns of numbers from a CSV file or from a table in memory."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptdrive.errors import IdentificationError, reason_of

Array = NDArray[np.float64]

_DELIMITERS = ";\t,"
"""In the order in which they are looked for: a comma may be a decimal one."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Named columns, whose values are read when they are needed.

    Attributes:
        source: Where they come from, for messages.
        values: Values of each column as they are.
        place: Where the value of a row is, for messages.
        decimal_comma: Whether a comma in a number is its decimal point.
    """

    source: str
    values: Mapping[str, Sequence[Any]]
    place: Callable[[int], str]
    decimal_comma: bool = False

    def numbers(self, name: str) -> Array:
        """Return a column as numbers; dates and times as seconds.

        Raises:
            IdentificationError: There is no such column, or a value of it is no number.
        """
        if name not in self.values:
            names = ", ".join(self.values)
            raise IdentificationError(f"{self.source}: no column {name!r}; there are: {names}")
        values = [_number(value, comma=self.decimal_comma) for value in self.values[name]]
        made = np.array(values, dtype=np.float64)
        wrong = np.flatnonzero(~np.isfinite(made))
        if len(wrong):
            row = int(wrong[0])
            raise IdentificationError(
                f"{self.source}: {self.place(row)}, column {name!r}: {self.values[name][row]!r} is "
                "not a number; correct it, or leave out the whole row"
            )
        return made


def _number(value: object, *, comma: bool) -> float:
    """Return a value as a number, a date as seconds, NaN for anything else."""
    if isinstance(value, np.datetime64):
        value = value.astype("datetime64[us]").item()
    if isinstance(value, str):
        return _from_text(value.strip(), comma=comma)
    if isinstance(value, datetime):
        return value.timestamp()
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return math.nan


def _from_text(text: str, *, comma: bool) -> float:
    for read in (float, _seconds):
        try:
            return read(text.replace(",", ".") if comma else text)
        except ValueError:
            continue
    return math.nan


def _seconds(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def columns_of_file(path: Path) -> Columns:
    """Return the columns of a CSV file.

    Names are those of its first line; numbers from 1 on where that line has numbers. The delimiter
    is a semicolon, a tabulator or a comma. Lines that begin with `#` are left out.

    Raises:
        IdentificationError: The file cannot be read, or a line has more or fewer values than the
            first one.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as problem:
        raise IdentificationError(f"{path}: cannot be read: {reason_of(problem)}") from problem
    except UnicodeDecodeError as problem:
        raise IdentificationError(f"{path}: is no text in UTF-8: {problem.reason}") from problem
    kept = [n for n, one in enumerate(lines, 1) if one.strip() and not one.startswith("#")]
    if not kept:
        raise IdentificationError(f"{path}: has no rows")
    first = lines[kept[0] - 1]
    delimiter = next((one for one in _DELIMITERS if one in first), ",")
    rows = list(csv.reader((lines[n - 1] for n in kept), delimiter=delimiter))
    for number, row in zip(kept, rows, strict=True):
        if len(row) != len(rows[0]):
            counts = f"{len(row)} values, where line {kept[0]} has {len(rows[0])}"
            raise IdentificationError(f"{path}: line {number}: {counts}")
    return _with_names(path, kept, rows, decimal_comma=delimiter != ",")


def _with_names(
    path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], *, decimal_comma: bool
) -> Columns:
    """Return columns by the names of the first row, or by numbers where it has numbers."""
    names = [one.strip() for one in rows[0]]
    bare = np.isfinite([_number(one, comma=decimal_comma) for one in names]).all()
    head = 0 if bare else 1
    if bare:
        names = [str(number) for number in range(1, len(names) + 1)]
    for name in names:
        if names.count(name) > 1:
            raise IdentificationError(f"{path}: two columns have the name {name!r}")
    values = {name: [row[place] for row in rows[head:]] for place, name in enumerate(names)}
    return Columns(str(path), values, lambda row: f"line {lines[row + head]}", decimal_comma)


def columns_of_table(table: Any) -> Columns:  # noqa: ANN401 - of any library
    """Return the columns of a table: of polars, pandas or pyarrow, or arrays by name.

    Raises:
        IdentificationError: It has no named columns, or they are not of one length.
    """
    names = _names(table)
    if names is None:
        kind = type(table).__name__
        raise IdentificationError(
            f"a {kind} has no named columns: give arrays by name, such as "
            '{"u": [...], "y": [...]}, or a table'
        )
    values = {str(name): list(np.asarray(table[name])) for name in names}
    lengths = {name: len(column) for name, column in values.items()}
    if len(set(lengths.values())) > 1:
        raise IdentificationError(f"the columns have different lengths: {lengths}")
    return Columns("table", values, lambda row: f"row {row} (the first is 0)")


def _names(table: Any) -> Iterable[Any] | None:  # noqa: ANN401 - of any library
    """Return the names of the columns, None where the table has none."""
    for found in ("column_names", "columns", "keys"):
        names = getattr(table, found, None)
        if callable(names):
            names = names()
        if names is not None and all(isinstance(one, str) for one in names):
            return list(names)
    names = getattr(getattr(table, "dtype", None), "names", None)
    return names or None
