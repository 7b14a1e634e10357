"""Columns of numbers from a CSV file or from a table in memory, with the units of their headers."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from adaptdrive.config.section import Converted, known_unit, si_unit
from adaptdrive.identification.excerpt import Array
from adaptdrive.util.errors import IdentificationError, reason_of

# Units in the headers of columns: `time_ms`, `Zeit [min]`, `speed (rpm)`, `t/s`.

_SECONDS = {
    **dict.fromkeys(("ns", "nanoseconds"), 1e-9),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microseconds"), 1e-6),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sekunden"), 1.0),
    **dict.fromkeys(("min", "mins", "minute", "minutes", "minuten"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours", "stunden"), 3600.0),
    **dict.fromkeys(("d", "day", "days", "tage"), 86400.0),
}
"""Seconds in each unit of time."""

_BRACKETED = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_LONGEST_S = 1e11
"""Time, 3000 years, from which on a number is no count of seconds."""


def written_unit(header: str) -> str | None:
    """Return the unit in brackets at the end of a header, None for none."""
    found = _BRACKETED.search(header)
    return found[1].strip() if found else None


def seconds_of(times: Array, header: str, place: str) -> Array:
    """Return times in seconds.

    Args:
        times: Times in the unit of the header; in seconds where it has none.
        header: Name of the column.
        place: Where the column is, for messages.

    Raises:
        IdentificationError: The unit is not one of time, or is left out where it is not seconds.
    """
    unit, last = written_unit(header), re.split(r"[\s_/]+", header.strip().lower())[-1]
    if unit is None and last not in _SECONDS:
        if len(times) and np.abs(times).max() >= _LONGEST_S:
            raise IdentificationError(
                f"{place}, column {header!r}: {times[0]:.0f} is no time in seconds: write its unit "
                f"into the header, such as {header + '_ms'!r}"
            )
        return times
    factor = _SECONDS.get(last if unit is None else unit.lower())
    if factor is None:
        raise IdentificationError(
            f"{place}, column {header!r}: {unit!r} is no unit of time: write ns, us, ms, s, min, h "
            "or d"
        )
    return (times - times[:1]) * factor  # a difference first: an epoch has more digits than fit


def quantity_of(values: Array, header: str, wanted: str, place: str) -> Array:
    """Return values of a column in the unit of a quantity.

    Args:
        values: Values in the unit of the header; in that of the quantity where it has none.
        header: Name of the column.
        wanted: Unit of the quantity. A last part of the header that is another unit of the same
            kind, as in `voltage_mV`, is obeyed; in `speed_s` it is no unit.
        place: Where the column is, for messages.

    Raises:
        IdentificationError: The unit of the header does not lead to that of the quantity.
    """
    written = written_unit(header) or _suffix(header, wanted)
    if written is None or written == wanted:
        return values
    unit, to_be = known_unit(written), known_unit(wanted)
    if unit is not None and unit == to_be:
        return values
    if unit is None or to_be is None or si_unit(unit) != to_be:
        raise IdentificationError(
            f"{place}, column {header!r}: is in {written}, where the configuration has "
            f"{wanted or 'no unit'}: convert it, and correct the header"
        )
    rule = Converted.model_validate({"unit": unit})
    return rule.scale * values + rule.offset


def _suffix(header: str, wanted: str) -> str | None:
    """Return the last part of a header where it is a unit that leads to the wanted one."""
    last = re.split(r"[_/]", header.strip())[-1]
    unit = known_unit(last)
    return last if unit is not None and si_unit(unit) == known_unit(wanted) else None


# Columns of numbers from a CSV file or from a table in memory.

_DELIMITERS = ";\t,"
"""In the order in which they are looked for: a comma may be a decimal one."""

_SEEN = 50
"""Last lines of a file, which show its delimiter and the number of its columns."""


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
        """Return a column as numbers; dates and times as seconds since 1970.

        A time without a zone is taken as it stands.

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

    def times_s(self, name: str) -> Array:
        """Return a column of times in seconds: numbers in the unit of its header, or dates.

        Raises:
            IdentificationError: As above, or its unit is not known.
        """
        times = self.numbers(name)
        dated = any(_is_date(value, comma=self.decimal_comma) for value in self.values[name][:1])
        return times if dated else seconds_of(times, name, self.source)


def _is_date(value: object, *, comma: bool) -> bool:
    if isinstance(value, str):
        return math.isnan(_plain(value, comma=comma))
    return isinstance(value, datetime | np.datetime64)


def _plain(text: str, *, comma: bool) -> float:
    """Return a text as a number, NaN where it is none."""
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return math.nan


def _number(value: Any, *, comma: bool) -> float:  # noqa: ANN401 - whatever a table holds
    """Return a value as a number, a date as seconds since 1970, NaN for anything else."""
    if isinstance(value, np.datetime64):
        value = value.astype("datetime64[us]").item()
    try:
        if isinstance(value, str):
            plain = _plain(value, comma=comma)
            value = datetime.fromisoformat(value.strip()) if math.isnan(plain) else plain
        if isinstance(value, datetime):
            # one without a zone as if it were UTC: only differences count
            value = (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def columns_of_file(path: Path) -> Columns:
    """Return the columns of a CSV file in UTF-8 or Latin-1.

    The delimiter is a semicolon, a tabulator or a comma. Names are those of the first line that
    has as many values as the last ones, and no empty one; numbers from 1 on where that line has
    numbers. What stands before it, and lines that begin with `#`, are left out; units in brackets
    may stand in a line below the names.

    Raises:
        IdentificationError: The file cannot be read, or a line has more or fewer values than the
            first one.
    """
    lines = _text(path).splitlines()
    kept = [n for n, one in enumerate(lines, 1) if one.strip() and not one.startswith("#")]
    if not kept:
        raise IdentificationError(f"{path}: has no rows")
    delimiter, width = _form([lines[n - 1] for n in kept[-_SEEN:]])
    rows = list(csv.reader((lines[n - 1] for n in kept), delimiter=delimiter))
    comma = delimiter != ","
    head = _head(rows, width, comma=comma)
    kept, rows = kept[head:], rows[head:]
    for number, row in zip(kept, rows, strict=True):
        if len(row) != width:
            counts = f"{len(row)} values, where line {kept[0]} has {width}"
            raise IdentificationError(f"{path}: line {number}: {counts}")
    return _with_names(path, kept, rows, decimal_comma=comma)


def _text(path: Path) -> str:
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise IdentificationError(f"{path}: cannot be read: {reason_of(problem)}") from problem
    if b"\0" in content:
        raise IdentificationError(f"{path}: is no text in UTF-8 or Latin-1: it has a byte 0")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _form(lines: Sequence[str]) -> tuple[str, int]:
    """Return the delimiter that divides most lines alike, and into how many values."""
    found = []
    for delimiter in _DELIMITERS:
        widths = Counter(map(len, csv.reader(lines, delimiter=delimiter)))
        width, count = max(widths.items(), key=lambda one: (one[0] > 1) * one[1])
        found.append(((width > 1) * count, delimiter, width))
    _, delimiter, width = max(found, key=lambda one: one[0])
    return delimiter, width


def _head(rows: Sequence[Sequence[str]], width: int, *, comma: bool) -> int:
    """Return which row has the names, or the first numbers where none has names."""
    like = [n for n, row in enumerate(rows) if len(row) == width]

    def counted(row: Sequence[str]) -> int:
        return sum(math.isfinite(_number(one, comma=comma)) for one in row)

    first = next((n for n in like if counted(rows[n]) > 1), len(rows))
    above = [n for n in like if n < first]
    whole = [n for n in above if all(one.strip() for one in rows[n])]
    return next(iter([*whole, *above[-1:], *like]))


def _with_names(
    path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], *, decimal_comma: bool
) -> Columns:
    """Return columns by the names of the first row, or by numbers where it has numbers."""
    names = [one.strip() for one in rows[0]]
    bare = np.isfinite([_number(one, comma=decimal_comma) for one in names]).all()
    head = 0 if bare else 1
    if bare:
        names = [str(number) for number in range(1, len(names) + 1)]
    elif rows[1:] and all(written_unit(one) is not None for one in rows[1]):
        names = [f"{name} {unit.strip()}" for name, unit in zip(names, rows[1], strict=True)]
        head = 2
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
    names = [getattr(table, one, None) for one in ("column_names", "columns")]
    names += [list(table) if isinstance(table, Mapping) else None]
    names += [getattr(getattr(table, "dtype", None), "names", None)]
    named = (one for one in names if one is not None and all(isinstance(n, str) for n in one))
    return next(named, None)
