"""Uninterrupted parts of a recorded session, for identification."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from adaptdrive.analysis.curves import session_clock
from adaptdrive.control.signals import Mode, Stage
from adaptdrive.identification.excerpt import Excerpt
from adaptdrive.recording.reader import Session
from adaptdrive.recording.session import TableName
from adaptdrive.util.errors import IdentificationError

Array = NDArray[np.float64]

_COLUMNS = (
    "boost_voltage_V",
    "output",
    "reference",
    "load_power_W",
    "pole",
    "manual_V",
    "steady",
    "tick_period_s",
)
_LONGEST_GAP = 5
"""Missing readings in a row that are filled in on a straight line; a longer gap divides."""

_BLOCKS_PER_PERIOD = 10
_MOST_BLOCKS = 20_000


@dataclass(frozen=True, slots=True)
class Stretch:
    """Uninterrupted part of a session in which the drive ran, at a constant rate.

    Attributes:
        begin_s: Time of its first sample since the first tick of the session.
        period_s: Time between two samples.
        samples_per_period: Samples in a slow period; the first sample begins one.
        columns: Values of `boost_voltage_V`, `output`, `reference`, `load_power_W`, `pole`,
            `manual_V` and `steady`.
        modes: Mode asked for at each sample, as its place in `Mode`.
    """

    begin_s: float
    period_s: float
    samples_per_period: int
    columns: dict[str, Array]
    modes: NDArray[np.int8]

    @property
    def excerpt(self) -> Excerpt:
        """Return the part that identification needs."""
        return Excerpt(self.columns["boost_voltage_V"], self.columns["output"], self.period_s)


def read_stretches(
    session: Session, begin_s: float | None = None, end_s: float | None = None
) -> list[Stretch]:
    """Read the parts of a session in which the drive ran.

    Args:
        session: The session.
        begin_s: Seconds after its first tick, None for that tick.
        end_s: Seconds after its first tick, None for its last one.

    Raises:
        IdentificationError: The drive did not run in there, or for less than a slow period.
    """
    whole = [one for one in divided(session, begin_s, end_s) if one is not None]
    if not whole:
        raise IdentificationError(
            f"{session.path}: too short: the drive ran for less than a slow period in that time"
        )
    return whole


def divided(
    session: Session, begin_s: float | None = None, end_s: float | None = None
) -> list[Stretch | None]:
    """Read the same, with None for each part that is shorter than a slow period.

    Args:
        session: The session.
        begin_s: Seconds after its first tick, None for that tick.
        end_s: Seconds after its first tick, None for its last one.

    Raises:
        IdentificationError: The drive did not run in there.
    """
    rows = _running(session, begin_s or 0.0, math.inf if end_s is None else end_s)
    if len(rows["tick"]) < 2:
        raise IdentificationError(f"{session.path}: the drive did not run in that time")
    stride = int(np.median(np.diff(rows["tick"])))
    gaps = np.flatnonzero(np.diff(rows["tick"]) > (_LONGEST_GAP + 1) * stride) + 1
    parts = np.split(np.arange(len(rows["tick"])), gaps)
    period = session.info.ticks_per_period
    # one for all: the line's frequency wanders by less than matters, and one grid needs one period
    period_s = stride * float(np.mean(rows["tick_period_s"]))
    return [
        _stretch({n: v[part] for n, v in rows.items()}, stride, period, period_s) for part in parts
    ]


def block_samples(stretches: list[Stretch]) -> int:
    """Return how many samples to average: whole blocks fill a slow period, or the reverse."""
    per_period = stretches[0].samples_per_period
    total = sum(len(one.columns["output"]) for one in stretches)
    wanted = max(per_period / _BLOCKS_PER_PERIOD, total / _MOST_BLOCKS)
    if wanted > per_period:
        return per_period * math.ceil(wanted / per_period)
    return min(n for n in range(1, per_period + 1) if per_period % n == 0 and n >= wanted)


def _running(session: Session, begin_s: float, end_s: float) -> dict[str, Any]:
    """Return time, tick and columns of the ticks with a fresh reading of a running drive."""
    clock = session_clock(session)
    first_s = math.nan
    kept: dict[str, list[Any]] = {n: [] for n in ("time_s", "mode", "tick", *_COLUMNS)}
    read = ("monotonic_s", "tick", "stage", "fresh", "mode", *_COLUMNS)
    for batch in session.batches(TableName.TICKS, read):
        time_s = clock(batch)
        first_s = time_s[0] if math.isnan(first_s) and len(time_s) else first_s
        since_s = time_s - first_s
        chosen = _equal(batch, "stage", Stage.RUN.value) & ~_equal(batch, "fresh", wanted=False)
        chosen &= (since_s >= begin_s) & (since_s <= end_s)
        kept["time_s"].append(since_s[chosen])
        kept["mode"].append(_modes(batch)[chosen])
        for name in ("tick", *_COLUMNS):
            values = batch.column(name).to_numpy(zero_copy_only=False)
            kept[name].append(np.asarray(values, dtype=np.float64)[chosen])
    return {name: np.concatenate(values) if values else [] for name, values in kept.items()}


def _modes(batch: pa.RecordBatch) -> NDArray[np.int8]:
    """Return the mode of each row, as its place in `Mode`: a byte, where a day has 10⁷ rows."""
    names = batch.column("mode").cast(pa.string())
    places = pc.index_in(names, value_set=pa.array([mode.value for mode in Mode]))
    return np.asarray(places.to_numpy(zero_copy_only=False), dtype=np.int8)


def _equal(batch: pa.RecordBatch, name: str, wanted: str | bool) -> NDArray[np.bool_]:
    """Return where a column has a value; null is none."""
    found = pc.fill_null(pc.equal(batch.column(name), wanted), fill_value=False)
    return np.asarray(found.to_numpy(zero_copy_only=False), dtype=np.bool_)


def _stretch(
    rows: dict[str, Any], stride: int, ticks_per_period: int, period_s: float
) -> Stretch | None:
    """Put rows on a regular grid that begins with a slow period."""
    ticks = rows["tick"]
    begin = math.ceil((ticks[0] - stride) / ticks_per_period) * ticks_per_period + stride
    grid = np.arange(begin, ticks[-1] + 1, stride)
    if len(grid) < 2:
        return None
    columns = {name: np.interp(grid, ticks, rows[name]) for name in _COLUMNS[:-1]}
    return Stretch(
        begin_s=float(np.interp(begin, ticks, rows["time_s"])),
        period_s=period_s,
        samples_per_period=max(1, ticks_per_period // stride),
        columns=columns,
        modes=rows["mode"][np.minimum(np.searchsorted(ticks, grid), len(ticks) - 1)],
    )
