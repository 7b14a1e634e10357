"""A record of one input and one output, made by any program, and the load that it shows."""

import itertools
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptdrive.analysis import closed_loop
from adaptdrive.analysis.columns import Columns, columns_of_file, columns_of_table, quantity_of
from adaptdrive.analysis.curves import Array, find_window, rows_within
from adaptdrive.analysis.excerpts import Stretch, block_samples, read_stretches
from adaptdrive.analysis.replay import reconfigured
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.config import Configuration, load_configuration
from adaptdrive.control.loads import bath, motor
from adaptdrive.control.loads.load import Load
from adaptdrive.control.signals import Estimate
from adaptdrive.identification import identify_any, proposed_model, time_constants
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.identification.result import IdentifiedLoad
from adaptdrive.recording.reader import Session, read_session
from adaptdrive.recording.session import TableName
from adaptdrive.util.errors import IdentificationError

# Which columns of a record are used, and at which times.

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
        name = _named(columns.values, _TIMES)
        if name is None:
            raise IdentificationError(
                f"{columns.source}: no column of times among {', '.join(columns.values)}: name it "
                "(--time), or give the time between two rows (--sample-time)"
            )
    if name is None:
        step_s, count = view.sample_time_s, len(next(iter(columns.values.values()), ()))
        if step_s is None or not 0.0 < step_s < math.inf:
            raise IdentificationError(f"the time between two rows, {step_s} s, must be above 0")
        return step_s * np.arange(count, dtype=np.float64), view
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


def _chosen(columns: Columns, view: RecordView) -> RecordView:
    """Return the view with the names of input and output: known ones, or the two that are left."""
    taken = (view.time, view.input, view.output)
    left = [name for name in columns.values if name not in taken]
    found = {
        "input": view.input or _named(left, _INPUTS),
        "output": view.output or _named(left, _OUTPUTS),
    }
    rest = [name for name in left if name not in found.values()]
    unknown = [option for option, name in found.items() if name is None]
    if len(unknown) == len(rest):
        found |= dict(zip(unknown, rest, strict=True))
    elif unknown:
        raise IdentificationError(
            f"{columns.source}: which column is the {unknown[0]}? There are: "
            f"{', '.join(columns.values)}; name it (--{unknown[0]})"
        )
    return replace(view, input=found["input"], output=found["output"])


def _named(names: Iterable[str], known: frozenset[str]) -> str | None:
    """Return the first name that begins with a known word, None where there is none."""
    for name in names:
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


# The load that any record shows; that of a recorded session with the on-line estimates, too.

_MOST_BLOCKS = 4000

Part = tuple[float, Excerpt]
"""Time in s at which an uninterrupted part of a record begins, and its samples."""


@dataclass(frozen=True, slots=True)
class RecordLoad:
    """The load of a record.

    Attributes:
        name: Of the record.
        unit: Of the output; empty where it is not known.
        ends_s: Time at the end of the last block of each part of the record.
        load: The identified load.
        online: Last estimates of the daemon; empty where there are none.
        nominal: Parameters of the configured model; empty where there is none.
        model: Keys of `[load.model]`; gain and time constants without a configuration.
        left_out: Parts of the record that have too few samples.
    """

    name: str
    unit: str
    ends_s: tuple[float, ...]
    load: IdentifiedLoad
    online: dict[str, Estimate]
    nominal: dict[str, float]
    model: dict[str, Estimate]
    left_out: int


def _load_of(
    name: str, parts: list[Part], block: int, drive: Configuration | None, lags: Sequence[int] = ()
) -> RecordLoad:
    """Return the load of the structure that a record shows.

    Args:
        name: Of the record.
        parts: Its parts.
        block: Samples that are averaged.
        drive: The drive whose boost voltage and output they are; None for any input and output.
        lags: How many lags the load may have, where there is no drive.
    """
    structures = candidate_loads(drive) if drive else [plain_load(count) for count in lags]
    load = identify_any([one for _, one in parts], structures, block=block)
    used = [parts[place] for place in load.used]
    ends_s = (begin_s + len(one.output) // block * block * one.period_s for begin_s, one in used)
    left_out = len(parts) - len(used)
    found = RecordLoad(name, "", tuple(ends_s), load, {}, {}, time_constants(load), left_out)
    if drive is None:
        return found
    nominal, section = build_load(drive), drive.load
    values = nominal.physical(list(nominal.numerator), list(nominal.denominator))
    known = dict(zip(nominal.names, values, strict=True))
    model = proposed_model(load, section)
    return replace(found, unit=section.output_unit, nominal=known, model=model)


def plain_load(lags: int) -> Load:
    """Return the structure of a load whose input is measured.

    Raises:
        IdentificationError: It is of no order that can be identified.
    """
    if lags == 1:
        load = bath.bath_load(1.0, 1.0, 1.0, 0.0, 1.0)
        return replace(load, input_gain=1.0, input_exponent=1, names=("gain", "tau_s"))
    if lags != 2:
        raise IdentificationError(f"{lags} lags: a load has one or two")
    return motor.motor_load(1.0, 1.0, 1.0)


def identify_session(
    session: Session, begin_s: float | None = None, end_s: float | None = None
) -> tuple[RecordLoad, list[Stretch]]:
    """Identify the load of a recorded session, and return the parts of it that were used, too.

    Args:
        session: The session.
        begin_s: First second used, from the first tick on; None for the first.
        end_s: Last second used, None for the last.

    Raises:
        AdaptdriveError: The session cannot be read, or does not show its load.
    """
    configuration = reconfigured(session.config_text, session.path / "config.toml", ())
    stretches, short = read_stretches(session, begin_s, end_s)
    parts = [(one.begin_s, one.excerpt) for one in stretches]
    found = _load_of(session.path.name, parts, block_samples(stretches), configuration)
    online = _online(session, tuple(found.nominal), end_s)
    used = [stretches[place] for place in found.load.used]
    return replace(found, online=online, left_out=found.left_out + short), used


def _online(session: Session, names: tuple[str, ...], end_s: float | None) -> dict[str, Estimate]:
    """Return the last on-line estimates before a time."""
    found = dict.fromkeys(names, Estimate(math.nan, math.nan))
    window = find_window(session, None, end_s)
    for _, batch in rows_within(session, TableName.SLOW, ("estimates",), window):
        for one in itertools.chain.from_iterable(batch.column("estimates").to_pylist()):
            if one["name"] in found and math.isfinite(one["value"]):
                found[one["name"]] = Estimate(one["value"], one["std"])
    return found


# The load of whatever contains a record: a CSV file, a table, a simulation or a session.


def identify_source(
    source: Any,  # noqa: ANN401 - a table of any library too
    view: RecordView,
) -> RecordLoad:
    """Identify the load of a record.

    Args:
        source: A session's folder, a CSV file, a simulation, or a table.
        view: Which columns and which part of it.

    Raises:
        AdaptdriveError: The record cannot be read, or does not show its load.
    """
    if isinstance(source, str | Path):
        path = Path(source)
        if path.is_file():
            return _identify(columns_of_file(path), path.name, view)
        _refuse_columns(view, "a session")
        return identify_session(read_session(path), view.begin_s, view.end_s)[0]
    if isinstance(source, closed_loop.Simulation):
        _refuse_columns(view, "a simulation")
        # voltage and output of a reading are taken at once
        measured = replace(view, input="boost_voltage_V", output="output", time="time_s")
        measured = replace(measured, config=source.configuration, held=False)
        return _identify(columns_of_table(source.ticks), "simulation", measured)
    return _identify(columns_of_table(source), "table", view)


def _identify(columns: Columns, name: str, view: RecordView) -> RecordLoad:
    config = view.config
    if isinstance(config, str | Path):
        config = load_configuration(Path(config))
    parts = read_record(columns, replace(view, config=config))
    block = math.ceil(sum(len(one.output) for _, one in parts) / _MOST_BLOCKS)
    if config is not None and view.lags is not None:
        raise IdentificationError("lags and a configuration were given: it says how many there are")
    return _load_of(name, parts, block, config, (1, 2) if view.lags is None else (view.lags,))


def _refuse_columns(view: RecordView, kind: str) -> None:
    """Refuse what a record without a choice of columns does not take."""
    if view != RecordView(begin_s=view.begin_s, end_s=view.end_s):
        raise IdentificationError(
            f"{kind} has its columns, its times and its configuration: leave out all but the times "
            "at which the used part begins and ends"
        )
