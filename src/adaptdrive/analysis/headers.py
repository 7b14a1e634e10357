"""Units in the headers of columns: `time_ms`, `Zeit [min]`, `speed (rpm)`, `t/s`."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from adaptdrive.config.units import Converted, known_unit, si_unit
from adaptdrive.util.errors import IdentificationError

Array = NDArray[np.float64]

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
