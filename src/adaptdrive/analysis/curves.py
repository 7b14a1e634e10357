"""Curves of a session, as many points as a figure can show; responses, and their quality."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from adaptdrive.config.load import AnyLoad
from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import TableName
from adaptdrive.util.errors import RecordingError

Array = NDArray[np.float64]

_BINS = 3000
"""Points across a figure; each shows the least and the largest value of its time."""

_MOST_STEPS = 6000
"""Slow steps that a figure shows; of more, every n-th."""

_GAP_PERIODS = 3.0
"""Time between two slow steps from which on they are no line: late ones are none."""

_TICK_COLUMNS = ("output", "reference", "boost_voltage_V", "command_boost_reference_V")
_SLOW_COLUMNS = ("controller", "accepted", "applied_V", "boost_reference_V", "estimates", "reason")


Window = tuple[float, float, datetime]
"""Monotonic times at the edges of a part of a session, and the wall-clock time of the left one."""


@dataclass(frozen=True, slots=True)
class Curves:
    """Data of the figure of a session.

    Attributes:
        window: What part of the session it is.
        ticks: Fast quantities by column: times since the left edge, and values; the least and the
            largest value of each time make one line, which fills what it cannot resolve.
        slow_s: Time of each slow step since the left edge.
        slow: Columns of slow steps.
        estimates: Value and standard deviation over time, by name.
    """

    window: Window
    ticks: dict[str, tuple[Array, Array]]
    slow_s: Array
    slow: dict[str, NDArray[np.generic]]
    estimates: dict[str, tuple[Array, Array]]

    @property
    def period_s(self) -> float:
        """Usual time from one slow step to the next."""
        return float(np.median(np.diff(self.slow_s))) if len(self.slow_s) > 1 else 1.0

    @property
    def breaks(self) -> NDArray[np.int64]:
        """Slow steps before which others are missing: none were made, or they are lost."""
        return np.flatnonzero(np.diff(self.slow_s) > _GAP_PERIODS * self.period_s) + 1

    def broken(self, values: NDArray[np.generic]) -> Array:
        """Return values of slow steps, or their times, as a line with gaps."""
        return np.insert(np.asarray(values, dtype=np.float64), self.breaks, np.nan)


def find_window(session: Session, begin_s: float | None, end_s: float | None) -> Window:
    """Return a part of a session.

    Args:
        session: The session.
        begin_s: Seconds after its first tick, None for that tick.
        end_s: Seconds after its first tick, None for its last one.

    Raises:
        RecordingError: There is no tick in it.
    """
    ends = session.ends(TableName.TICKS, ("utc", "monotonic_s", "tick"))
    if ends is None:
        raise RecordingError(session.path, "it holds no ticks")
    first, last = row_times(session, ends[0])[0], row_times(session, ends[1])[-1]
    begin = first + (begin_s or 0.0)
    end = last if end_s is None else min(last, first + end_s)
    if not begin < end:
        raise RecordingError(session.path, f"it holds {last - first:.6g} s, none of them in there")
    started = ends[0].column("utc")[0].as_py() or session.info.started.astimezone(UTC)
    return begin, end, started + timedelta(seconds=begin - first)


def row_times(session: Session, batch: pa.RecordBatch) -> Array:
    """Return the monotonic time of rows; from the tick where it is not recorded."""
    time_s = _floats(batch.column("monotonic_s"))
    if len(time_s) and math.isnan(time_s[0]):
        return _floats(batch.column("tick")) * (0.5 / session.info.line_frequency_Hz)
    return time_s


def read_curves(session: Session, window: Window) -> Curves:
    """Read what a figure shows of a session; of many slow steps every n-th."""
    steps = list(rows_within(session, TableName.SLOW, _SLOW_COLUMNS, window))
    slow_s = np.concatenate([np.empty(0), *(time_s for time_s, _ in steps)])
    ticks = _envelopes(session, window)
    if not steps:
        return Curves(window, ticks, slow_s, slow={}, estimates={})
    shown = np.arange(0, len(slow_s), 1 + len(slow_s) // _MOST_STEPS)
    # `pa.array` would load pandas wherever that is installed
    indices = pa.Array.from_buffers(pa.int64(), len(shown), [None, pa.py_buffer(shown)])
    table = pa.Table.from_batches([batch for _, batch in steps]).take(indices)
    rows = table.combine_chunks().to_batches()[0]
    slow = {name: _values(rows, name) for name in _SLOW_COLUMNS if name != "estimates"}
    return Curves(window, ticks, slow_s[shown], slow, _estimates(rows))


def rows_within(
    session: Session, table: str, columns: tuple[str, ...], window: Window
) -> Iterator[tuple[Array, pa.RecordBatch]]:
    """Yield the rows of a part of a session, with their times since its left edge."""
    begin_s, end_s, _ = window
    for batch in session.batches(table, ("monotonic_s", "tick", *columns)):
        time_s = row_times(session, batch)
        first, last = np.searchsorted(time_s, (begin_s, end_s), side="left")
        if first < last:
            yield time_s[first:last] - begin_s, batch.slice(first, last - first)


def _envelopes(session: Session, window: Window) -> dict[str, tuple[Array, Array]]:
    begin_s, end_s, _ = window
    width_s = (end_s - begin_s) / _BINS
    low = {name: np.full(_BINS, np.inf) for name in _TICK_COLUMNS}
    high = {name: np.full(_BINS, -np.inf) for name in _TICK_COLUMNS}
    for time_s, batch in rows_within(session, TableName.TICKS, _TICK_COLUMNS, window):
        bins = np.minimum((time_s / width_s).astype(np.int64), _BINS - 1)
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        at = bins[starts]
        for name in _TICK_COLUMNS:
            values = _floats(batch.column(name))
            low[name][at] = np.minimum(low[name][at], np.minimum.reduceat(values, starts))
            high[name][at] = np.maximum(high[name][at], np.maximum.reduceat(values, starts))
    filled = np.isfinite(low["output"])
    time_s = np.repeat(((np.arange(_BINS) + 0.5) * width_s)[filled], 2)
    return {
        name: (time_s, np.column_stack((low[name][filled], high[name][filled])).ravel())
        for name in _TICK_COLUMNS
    }


def _estimates(rows: pa.RecordBatch) -> dict[str, tuple[Array, Array]]:
    found: dict[str, tuple[Array, Array]] = {}
    column = rows.column("estimates")
    at = np.from_dlpack(pc.list_parent_indices(column))
    flat = pc.list_flatten(column)
    names = np.asarray(flat.field("name").to_pylist())
    for name in np.unique(names):
        found[name] = np.full(rows.num_rows, np.nan), np.full(rows.num_rows, np.nan)
        chosen = names == name
        for values, part in zip(found[name], ("value", "std"), strict=True):
            values[at[chosen]] = _floats(flat.field(part))[chosen]
    return found


def _floats(column: pa.Array) -> Array:
    """Return numbers; `to_numpy` would load pandas wherever that is installed."""
    numbers = column.cast(pa.float64())
    if numbers.null_count:
        numbers = numbers.fill_null(math.nan)
    return np.asarray(np.from_dlpack(numbers), dtype=np.float64)


def _values(batch: pa.RecordBatch, name: str) -> NDArray[np.generic]:
    column = batch.column(name)
    return _floats(column) if column.type == pa.float64() else np.asarray(column.to_pylist())


# Quality of control: steps of the set-point, error, effort.


_LEAST_STEP = 0.01
"""Smallest step that is judged, as a share of the set-points' range."""


_LEAST_PERIODS = 10
"""Slow periods for which a set-point must stay to be judged."""


_BAND = 0.05
"""Distance from the set-point, in steps, at which a response has settled."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of control; NaN where no step can be judged.

    Attributes:
        steps: Steps of the set-point that were judged.
        overshoot: Median overshoot, as a share of the step.
        settling_s: Median time to stay within 5 % of the step.
        unsettled: Steps that did not settle before the next one.
        error: Rms distance from the set-point.
        effort_V: Rms change of the boost voltage from one slow period to the next.
        highest_V: Largest mean boost voltage of a slow period.
    """

    steps: int
    overshoot: float
    settling_s: float
    unsettled: int
    error: float
    effort_V: float
    highest_V: float


def quality_of(
    reference: Array, output: Array, volts: Array, period_s: float, span: float
) -> Quality:
    """Judge means over slow periods.

    Args:
        reference: Set-point at the end of each slow period.
        output: Output, mean over each slow period.
        volts: Boost voltage, mean over each slow period.
        period_s: Slow period.
        span: Range of the set-points.
    """
    judged = [
        judge_step(output[first:last], reference[first - 1], reference[first])
        for first, last in _steps(reference, span)
    ]
    settled = [periods for _, periods in judged if math.isfinite(periods)]
    return Quality(
        steps=len(judged),
        overshoot=float(np.median([one for one, _ in judged])) if judged else math.nan,
        settling_s=float(np.median(settled)) * period_s if settled else math.nan,
        unsettled=len(judged) - len(settled),
        error=float(np.sqrt(np.mean((output - reference) ** 2))),
        effort_V=float(np.sqrt(np.mean(np.diff(volts) ** 2))) if len(volts) > 1 else math.nan,
        highest_V=float(volts.max()),
    )


def _steps(reference: Array, span: float) -> list[tuple[int, int]]:
    """Return first and last period of each set-point that was stepped to and held."""
    changes = np.flatnonzero(np.abs(np.diff(reference)) > 1e-9 * span) + 1
    ends = np.append(changes, len(reference))[1:]
    return [
        (int(first), int(last))
        for first, last in zip(changes, ends, strict=True)
        if last - first >= _LEAST_PERIODS
        and abs(reference[first] - reference[first - 1]) >= _LEAST_STEP * span
    ]


def judge_step(output: Array, before: float, after: float) -> tuple[float, float]:
    """Return overshoot and slow periods to settle, infinite where it does not.

    Args:
        output: From the step to the next one.
        before: Set-point before it.
        after: Set-point after it.
    """
    error = (output - after) / (after - before)
    outside = np.flatnonzero(np.abs(error) > _BAND)
    periods = float(outside[-1] + 1) if len(outside) else 0.0
    return max(0.0, float(error.max())), periods if periods < len(output) else math.inf


# The response of a loop, simulated or recorded, as means over slow periods.

_RESPONSE = ("reference", "output", "boost_voltage_V")


@dataclass(frozen=True, slots=True)
class Response:
    """Response of a loop, as means over slow periods.

    Attributes:
        time_s: Time of each slow period.
        reference: Set-point at its end.
        output: The regulated quantity.
        boost_voltage_V: v_bst.
        quality: Judgement of it.
        fault: Cause that ended it early, empty for none.
    """

    time_s: Array
    reference: Array
    output: Array
    boost_voltage_V: Array
    quality: Quality
    fault: str = ""


def response_of(
    columns: Mapping[str, Array], samples: int, time_s: Array, section: AnyLoad, fault: str = ""
) -> Response:
    """Return the response of a loop.

    Args:
        columns: Set-point, output and boost voltage at each reading; those before the first slow
            period are left out.
        samples: Readings in a slow period.
        time_s: Time of each slow period.
        section: The load, with its slow period and the range of its set-points.
        fault: Cause that ended the loop early, empty for none.
    """
    from adaptdrive.identification.excerpt import means_of  # noqa: PLC0415 - demonstrations do without

    first = (len(columns["output"]) // samples - len(time_s)) * samples
    reference, output, volts = (columns[name][first:] for name in _RESPONSE)
    reference = reference[samples - 1 :: samples]
    output, volts = means_of(output, samples), means_of(volts, samples)
    span = section.reference_max - section.reference_min
    quality = quality_of(reference, output, volts, section.period_s, span)
    return Response(time_s, reference, output, volts, quality, fault)
