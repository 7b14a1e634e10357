"""The health of a load: a row an hour of its estimates, in a file that outlives the sessions.

Estimates of one slow period and the next resemble each other: with the forgetting factor ρ each
sample that teaches brings 1 - ρ of what an estimate knows. An hour with n such samples counts as
(1 - ρ) n independent estimates, each with the variance

    max( mean of σ_k², 2 s² )

with σ_k as shown at each slow step, and s² the variance of the estimates within the hour. A load
that moves as predicted teaches nothing: its estimate is repeated, and counts as none. At rest
nothing shows the load, and an hour has no value.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from operator import attrgetter
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from adaptdrive.control import thresholds
from adaptdrive.control.loads.load import OFFSET, derived
from adaptdrive.control.signals import Stage
from adaptdrive.recording import records, segments, tables
from adaptdrive.recording.session import Ending, SessionInfo, TableName, read_info
from adaptdrive.util import trends

HOUR_S = 3600.0


class Mean(msgspec.Struct, frozen=True, array_like=True):
    """A weighted mean over an hour.

    Attributes:
        value: The mean.
        std: Standard deviation of one estimate.
        count: Independent estimates behind it.
    """

    value: float
    std: float
    count: float


class HourRow(msgspec.Struct, frozen=True, tag="hour", tag_field="row"):
    """An hour of a session.

    Attributes:
        time: Begin of the hour, UTC.
        session: Begin of the session.
        running_h: Time that the load was fed.
        starts: How often that began.
        means: Quantities that it has shown, by name.
        changes: What has changed, as the bank of models decided.
    """

    time: datetime
    session: datetime
    running_h: float
    starts: int
    means: dict[str, Mean]
    changes: tuple[str, ...] = ()


class BoundRow(msgspec.Struct, frozen=True, tag="bound", tag_field="row"):
    """A crossing of a bound of `[health]`.

    Attributes:
        time: Begin of the hour with which it was found.
        name: The quantity.
        outside: Whether it has left its bounds.
    """

    time: datetime
    name: str
    outside: bool


Row = HourRow | BoundRow


def health_path(sessions: Path, drive: str) -> Path:
    """Return the file of a drive in a folder of sessions."""
    return sessions / f"{drive}.health.jsonl"


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a file by their times, none without one; torn lines are left out."""
    rows: list[Row] = []
    for line in path.read_bytes().splitlines() if path.exists() else ():
        try:
            rows.append(msgspec.json.decode(line, type=Row))
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
    return sorted(rows, key=attrgetter("time"))


def append_rows(path: Path, rows: Sequence[Row]) -> None:
    """Append rows to a file, after a torn line on one of their own.

    Raises:
        OSError: They cannot be written.
    """
    with path.open("ab+") as file:
        file.seek(max(0, file.tell() - 1))
        torn = file.read() not in {b"", b"\n"}
        content = b"".join(msgspec.json.encode(one) + b"\n" for one in rows)
        file.write(b"\n" + content if torn else content)
        file.flush()
        os.fsync(file.fileno())


# Rows from the slow steps of a session.

_COLUMNS = ("utc", "period_s", "stage", "accepted", "excitation", "estimates", "change")

_DIGITS = 8


@dataclass
class _Sum:
    """Sums over the estimates of one quantity in an hour, as differences from the first."""

    first: float = math.nan
    count: int = 0
    taught: int = 0
    weight: float = 0.0
    moment: float = 0.0
    square: float = 0.0

    def add(self, value: float, std: float, *, teaches: bool) -> None:
        if self.count == 0:
            self.first = value
        weight, moved = 1.0 / (std * std), value - self.first
        self.count += 1
        self.taught += teaches
        self.weight += weight
        self.moment += weight * moved
        self.square += weight * moved * moved

    def mean(self, share: float) -> Mean:
        moved = self.moment / self.weight
        variance = max(0.0, self.square / self.weight - moved * moved)
        std = math.sqrt(max(self.count / self.weight, 2.0 * variance))
        return Mean(_rounded(self.first + moved), _rounded(std), _rounded(share * self.taught))


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


@dataclass
class _Hour:
    """What an hour of a session has shown so far."""

    running_s: float = 0.0
    starts: int = 0
    sums: dict[str, _Sum] = field(default_factory=dict)
    changes: list[str] = field(default_factory=list)


def session_rows(
    directory: Path, info: SessionInfo, settings: records.HealthSettings, after: datetime | None
) -> list[HourRow]:
    """Return the rows of the hours of a session that are complete, or that it ended in.

    Args:
        directory: Directory of the session.
        info: Its facts.
        settings: What gives its estimates their meaning.
        after: Begin of the last hour that has a row, None for none.

    Raises:
        RecordingError: Its slow steps cannot be read.
    """
    hours: dict[datetime, _Hour] = {}
    fed, now = False, None
    for step in _steps(directory, info, after):
        time: datetime = step["utc"]
        now = time.replace(minute=0, second=0, microsecond=0)
        hour = hours.setdefault(now, _Hour())
        before, fed = fed, step["stage"] == Stage.RUN
        hour.running_s += step["period_s"] if fed else 0.0
        hour.starts += fed and not before
        _add(hour, step, settings)
    if info.ended is Ending.OPEN and now is not None:
        hours.pop(now)
    found = ((time, hour) for time, hour in hours.items() if after is None or time > after)
    return [_row(time, info.started, hour, settings) for time, hour in found]


def add_rows(directory: Path, settings: records.HealthSettings) -> list[Row]:
    """Append the rows that a session has more than the file of its drive; return all of that.

    Args:
        directory: Directory of the session.
        settings: What gives its estimates their meaning.

    Raises:
        RecordingError: The session cannot be read.
        OSError: The rows cannot be written.
    """
    info = read_info(directory)
    path = health_path(directory.parent, info.drive)
    known = read_rows(path)
    own = [one.time for one in known if isinstance(one, HourRow) and one.session == info.started]
    if new := session_rows(directory, info, settings, max(own, default=None)):
        append_rows(path, new)
    return [*known, *new]


def _row(
    time: datetime, started: datetime, hour: _Hour, settings: records.HealthSettings
) -> HourRow:
    means = {name: one.mean(settings.share) for name, one in hour.sums.items()}
    running_h = _rounded(hour.running_s / HOUR_S)
    return HourRow(time, started, running_h, hour.starts, means, tuple(hour.changes))


def _steps(directory: Path, info: SessionInfo, after: datetime | None) -> Iterator[dict[str, Any]]:
    """Yield the archived slow steps of a session, from one before the end of an hour on."""
    table = TableName.SLOW
    whole = tables.table_schema(table, info)
    schema: dict[str, pa.Schema] = {table: pa.schema([whole.field(name) for name in _COLUMNS])}
    found = segments.segments(directory, None, (table,))
    first = 0
    if after is not None:
        earlier = (
            place for place in reversed(range(len(found))) if _begins(found[place], schema, after)
        )
        first = next(earlier, 0)
    for segment in found[first:]:
        for _, batch in segment.rows(schema):
            yield from (one for one in batch.to_pylist() if one["utc"] is not None)


def _begins(segment: segments.Segment, schema: dict[str, Any], time: datetime) -> bool:
    """Return whether a segment begins no later than a time."""
    begin = next((batch.column("utc")[0].as_py() for _, batch in segment.rows(schema)), None)
    return begin is not None and begin <= time


def _add(hour: _Hour, step: Mapping[str, Any], settings: records.HealthSettings) -> None:
    """Add the estimates of a slow step that shows the load, and what has changed in it."""
    if step["change"]:
        hour.changes.append(step["change"])
    estimates = {one["name"]: (one["value"], one["std"]) for one in step["estimates"] or ()}
    known = {name: pair for name, pair in estimates.items() if all(map(math.isfinite, pair))}
    values = {name: value for name, (value, _) in known.items()}
    shares = {name: std / abs(value) for name, (value, std) in known.items() if value}
    if not (step["accepted"] and _shows_load(shares)):
        return
    teaches = step["excitation"] > settings.least_excitation
    powers = {one.name: one.powers for one in settings.products}
    every = values | derived(settings.products, settings.loss, values)
    for name, value in every.items():
        parts = powers.get(name, ((name, 1),))
        std = abs(value) * sum(shares.get(one, 0.0) * abs(power) for one, power in parts)
        if name in {OFFSET, settings.loss}:
            std = known[OFFSET][1]
        elif std > thresholds.PRIOR_SHARE * abs(value):
            continue
        if std > 0.0:
            hour.sums.setdefault(name, _Sum()).add(value, std, teaches=teaches)


def _shows_load(shares: Mapping[str, float]) -> bool:
    """Return whether a time constant is known: none is once nothing has shown the load."""
    lags = (share for name, share in shares.items() if name.startswith("tau_"))
    return min(lags, default=math.inf) < thresholds.PRIOR_SHARE


def points(rows: Iterable[Row]) -> dict[str, list[trends.Point]]:
    """Return the courses of the quantities: a point in the middle of each hour that shows them."""
    found: dict[str, list[trends.Point]] = {}
    for row in rows:
        if isinstance(row, HourRow):
            time_s = row.time.astimezone(UTC).timestamp() + 0.5 * HOUR_S
            for name, one in row.means.items():
                found.setdefault(name, []).append(
                    trends.Point(time_s, one.value, one.std, one.count)
                )
    return found
