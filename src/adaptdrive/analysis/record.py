"""A record of one input and one output, made by any program: which columns, and at which times."""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from adaptdrive.analysis.columns import Columns, quantity_of
from adaptdrive.config import Configuration
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.util.errors import IdentificationError

Array = NDArray[np.float64]

_TIMES = frozenset(
    {"time", "t", "seconds", "timestamp", "datetime", "date", "utc", "monotonic"}
    | {"epoch", "unix", "minutes", "hours", "zeit", "datum", "zeitstempel"}
)
_INPUTS = frozenset(
    {"boost", "input", "u", "voltage", "command", "drive", "heater", "power", "pwm", "duty", "q1"}
)
_OUTPUTS = frozenset({"output", "y", "speed", "temperature", "temp", "current", "measured", "t1"})

_SHORT = 200
"""Rows below which a record is short."""

_LONGEST_GAP = 5.5
"""Distance of two rows, in sample times, up to which they belong to one part."""


@dataclass(frozen=True, slots=True)
class RecordView:
    """Options for reading a record; None leaves the choice to the reader.

    Attributes:
        input: Name of the column of the input.
        output: Name of the column of the output.
        time: Name of the column of times, in the unit of its header, else in seconds, or as dates.
        sample_time_s: Time between two rows, where no column of times is to be read.
        before: Input before the first row, under which the load had come to rest.
        lags: Lags of the load, 1 or 2; two if the record shows a second one.
        config: Configuration, or its file, of the drive whose boost voltage and output they are.
        begin_s: First second used, from the first row on.
        end_s: Last second used.
        held: Whether an input acts from its row to the next one; otherwise both columns were
            measured at once.
    """

    input: str | None = None
    output: str | None = None
    time: str | None = None
    sample_time_s: float | None = None
    before: float | None = None
    lags: int | None = None
    config: str | Path | Configuration | None = None
    begin_s: float | None = None
    end_s: float | None = None
    held: bool = True


def read_record(columns: Columns, view: RecordView) -> list[tuple[float, Excerpt]]:
    """Return the parts without a gap of the record that columns contain.

    Args:
        columns: The columns.
        view: Which of them, and which part.

    Returns:
        Time of the first sample since the first row, in s, and samples of each part.

    Raises:
        IdentificationError: A column is missing or cannot be guessed, a value is no number, the
            times do not rise, or the input shows nothing.
    """
    time_s, view = _times_s(columns, view)
    view = _chosen(columns, view)
    inputs, outputs = (columns.numbers(str(name)) for name in (view.input, view.output))
    if isinstance(view.config, Configuration):
        given, wanted = view.config.drive.manipulated.unit, view.config.load.output_unit
        inputs = quantity_of(inputs, str(view.input), given, columns.source)
        outputs = quantity_of(outputs, str(view.output), wanted, columns.source)
    if len(time_s) < 2:
        raise IdentificationError(f"{columns.source}: {len(time_s)} rows are no record")
    period_s = view.sample_time_s or float(np.median(np.diff(time_s)))
    gaps = np.flatnonzero(np.diff(time_s) > _LONGEST_GAP * period_s) + 1
    parts = []
    for number, rows in enumerate(np.split(np.arange(len(time_s)), gaps)):
        even_s = time_s[rows[0]] + period_s * np.arange(
            1 + math.floor((time_s[rows[-1]] - time_s[rows[0]]) / period_s + 1e-6)
        )
        held = rows[np.searchsorted(time_s[rows], even_s + 1e-6 * period_s) - 1]
        volts = inputs[held] if view.held else np.interp(even_s, time_s[rows], inputs[rows])
        values = np.interp(even_s, time_s[rows], outputs[rows])
        used = (even_s >= (view.begin_s or 0.0)) & (even_s <= (view.end_s or math.inf))
        if not used.any():
            continue
        first = int(np.argmax(used))
        before = _before(view, volts, first, whole=number == 0)
        rested = number == first == 0 and view.before is not None
        part = Excerpt(volts[used], values[used], period_s, before, rested, view.held)
        parts.append((float(even_s[first]), part))
    _require_movement(columns, view, [part for _, part in parts])
    return parts


def _before(view: RecordView, inputs: Array, first: int, *, whole: bool) -> float | None:
    """Return the input before the first used row, None where it is not known.

    Of a short record no row is left out for it: its input is taken to have rested.
    """
    if first > 0:
        return float(inputs[first - 1])
    if whole and view.before is not None:
        return view.before
    return float(inputs[0]) if whole and len(inputs) < _SHORT else None


def _times_s(columns: Columns, view: RecordView) -> tuple[Array, RecordView]:
    """Return the time of each row since the first, and the view with the column of times."""
    name = view.time
    if view.sample_time_s is None and name is None:
        name = _named(columns, _TIMES)
        if name is None:
            raise IdentificationError(
                f"{columns.source}: no column of times among {', '.join(columns.values)}: name it "
                "(--time), or give the time between two rows (--sample-time)"
            )
    if name is None:
        return _counted_s(columns, view.sample_time_s), view
    time_s = columns.times_s(name)
    back = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise IdentificationError(
            f"{columns.source}: {columns.place(row)}, column {name!r}: {columns.values[name][row]} "
            f"is not after {columns.values[name][row - 1]}: sort the rows, and leave out repeated "
            "ones"
        )
    return time_s - time_s[:1], replace(view, time=name)


def _counted_s(columns: Columns, sample_time_s: float | None) -> Array:
    if sample_time_s is None or not 0.0 < sample_time_s < math.inf:
        raise IdentificationError(f"the time between two rows, {sample_time_s} s, must be above 0")
    count = len(next(iter(columns.values.values()), ()))
    return sample_time_s * np.arange(count, dtype=np.float64)


def _chosen(columns: Columns, view: RecordView) -> RecordView:
    """Return the view with the names of input and output: known ones, or the two that are left."""
    taken = (view.time, view.input, view.output)
    left = Columns(
        columns.source,
        {name: values for name, values in columns.values.items() if name not in taken},
        columns.place,
    )
    found = {
        "input": view.input or _named(left, _INPUTS),
        "output": view.output or _named(left, _OUTPUTS),
    }
    rest = [name for name in left.values if name not in found.values()]
    unknown = [option for option, name in found.items() if name is None]
    if len(unknown) == len(rest):
        found |= dict(zip(unknown, rest, strict=True))
    elif unknown:
        raise IdentificationError(
            f"{columns.source}: which column is the {unknown[0]}? There are: "
            f"{', '.join(columns.values)}; name it (--{unknown[0]})"
        )
    return replace(view, input=found["input"], output=found["output"])


def _named(columns: Columns, known: frozenset[str]) -> str | None:
    """Return the first column whose name begins with a known word, None where there is none."""
    for name in columns.values:
        if re.split(r"[^a-z0-9]", name.lower().strip())[0] in known:
            return name
    return None


def _require_movement(columns: Columns, view: RecordView, parts: list[Excerpt]) -> None:
    """Make sure that the input changes, or has changed at the start."""
    if not parts:
        raise IdentificationError(f"{columns.source}: has no rows from --from to --to")
    levels = np.unique(np.concatenate([one.boost_voltage_V for one in parts]))
    before = parts[0].before_V
    if len(levels) == 1 and before in (None, levels[0]):
        raise IdentificationError(
            f"{columns.source}: column {view.input!r} is {levels[0]:.6g} in every row: where the "
            "record begins with a step, give the input before it (--before)"
        )
    if view.output == view.input:
        raise IdentificationError(f"{columns.source}: input and output are both {view.input!r}")
