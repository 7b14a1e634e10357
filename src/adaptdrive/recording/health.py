"""The health of a load: a row an hour of its estimates, in a file that outlives the sessions.

Estimates of one slow period and the next resemble each other: with the forgetting factor ρ each
sample that teaches brings 1 - ρ of what an estimate knows. An hour with n such samples counts as
(1 - ρ) n independent estimates, each with the variance

    max( mean of σ_k², 2 s² )

with σ_k as shown at each slow step, and s² the variance of the estimates within the hour. A load
that moves as predicted teaches nothing, and at rest nothing shows it: then an hour has no value.
"""

import math
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby, pairwise
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pyarrow as pa

from adaptdrive.control import thresholds
from adaptdrive.control.loads.load import OFFSET, derived
from adaptdrive.control.signals import Stage
from adaptdrive.recording import records, segments, tables
from adaptdrive.recording.session import Ending, SessionInfo, TableName, read_info
from adaptdrive.runtime.reports import Event, Severity
from adaptdrive.util import trends

HOUR_S = 3600.0

_LARGEST = 1e30
_Value = Annotated[float, msgspec.Meta(ge=-_LARGEST, le=_LARGEST)]
_Deviation = Annotated[float, msgspec.Meta(ge=1.0 / _LARGEST, le=_LARGEST)]

Mean = tuple[_Value, _Deviation]
"""A mean over an hour, and its standard deviation."""


class HourRow(msgspec.Struct, frozen=True):
    """An hour of a session.

    Attributes:
        time: Begin of the hour, UTC.
        session: Begin of the session.
        running_h: Time that the load was fed.
        starts: How often that began.
        means: Quantities that it has shown, by name.
        changes: What has changed, as the bank of models decided.
        outside: Quantities that have left their bounds and not come back.
    """

    time: Annotated[datetime, msgspec.Meta(tz=True)]
    session: datetime
    running_h: float
    starts: int
    means: dict[str, Mean]
    changes: tuple[str, ...] = ()
    outside: tuple[str, ...] = ()


def health_path(sessions: Path, drive: str) -> Path:
    """Return the file of a drive in a folder of sessions."""
    return sessions / f"{drive}.health.jsonl"


def read_rows(path: Path) -> list[HourRow]:
    """Return the rows of a file by their times, none without one.

    Lines that are torn, and hours of a clock that was ahead, later than the last row, are left out.
    """
    rows: list[HourRow] = []
    for line in path.read_bytes().splitlines() if path.exists() else ():
        try:
            rows.append(msgspec.json.decode(line, type=HourRow))
        except (msgspec.DecodeError, UnicodeDecodeError):
            continue
    return sorted((one for one in rows if one.time <= rows[-1].time), key=attrgetter("time"))


def append_rows(path: Path, rows: Sequence[HourRow]) -> None:
    """Append rows to a file, after a torn line on one of their own.

    Raises:
        OSError: They cannot be written.
    """
    with path.open("ab") as file:
        file.write(b"".join(b"\n" + msgspec.json.encode(one) for one in rows))
        file.flush()
        os.fsync(file.fileno())


# Rows from the slow steps of a session.

_COLUMNS = ("utc", "period_s", "stage", "accepted", "excitation", "estimates", "change")

Step = Mapping[str, Any]


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
    rows, fed = list[HourRow](), False
    for time, group in groupby(_steps(directory, info, after), _hour):
        steps = list(group)
        states = [fed, *(one["stage"] == Stage.RUN for one in steps)]
        fed = states[-1]
        running_s = math.fsum(one["period_s"] for one in steps if one["stage"] == Stage.RUN)
        starts = sum(now and not before for before, now in pairwise(states))
        changes = tuple(one["change"] for one in steps if one["change"])
        means = _means(steps, settings)
        rows.append(HourRow(time, info.started, running_s / HOUR_S, starts, means, changes))
    if info.ended is Ending.OPEN:
        rows = rows[:-1]
    return [one for one in rows if after is None or one.time > after]


def _hour(step: Step) -> datetime:
    time: datetime = step["utc"]
    return time.replace(minute=0, second=0, microsecond=0)


def _steps(directory: Path, info: SessionInfo, after: datetime | None) -> Iterator[Step]:
    """Yield the archived slow steps of a session, but for files that were closed before a time."""
    whole = tables.table_schema(TableName.SLOW, info)
    schema: dict[str, pa.Schema] = {
        TableName.SLOW: pa.schema([whole.field(name) for name in _COLUMNS])
    }
    for segment in segments.segments(directory, None, (TableName.SLOW,)):
        if after is None or segment.path.stat().st_mtime > after.timestamp():
            for _, batch in segment.rows(schema):
                yield from (one for one in batch.to_pylist() if one["utc"] is not None)


def _means(steps: Iterable[Step], settings: records.HealthSettings) -> dict[str, Mean]:
    samples = defaultdict[str, list[Mean]](list)
    for step in steps:
        for name, shown in _shown(step, settings).items():
            samples[name].append(shown)
    return {name: _mean(found, settings.share) for name, found in samples.items()}


def _mean(samples: Sequence[Mean], share: float) -> Mean:
    points = [trends.Point(0.0, *one) for one in samples]
    count, (value, std) = len(samples), trends.mean(points)
    scatter = math.fsum(((one - value) / own) ** 2 for one, own in samples) * std * std
    return value, math.sqrt(max(count * std * std, 2.0 * scatter) / (share * count))


def _shown(step: Step, settings: records.HealthSettings) -> dict[str, Mean]:
    """Return the quantities that a slow step teaches, with their deviations; none at rest."""
    pairs = {one["name"]: (one["value"], one["std"]) for one in step["estimates"] or ()}
    found = {name: pair for name, pair in pairs.items() if all(map(math.isfinite, pair))}
    values = {name: value for name, (value, _) in found.items()}
    shares = {name: std / abs(value) for name, (value, std) in found.items() if value}
    lags = (share for name, share in shares.items() if name.startswith("tau_"))
    teaches = step["accepted"] and step["excitation"] > settings.least_excitation
    if not teaches or min(lags, default=math.inf) >= thresholds.PRIOR_SHARE:
        return {}
    for name, value in derived(settings.products, settings.loss, values).items():
        powers = settings.products.get(name, {})
        own = abs(value) * sum(shares[one] * abs(power) for one, power in powers.items())
        found[name] = value, found[OFFSET][1] if name == settings.loss else own
    offsets = {OFFSET, settings.loss}
    return {
        name: (value, std)
        for name, (value, std) in found.items()
        if std > 0.0 and (name in offsets or std <= thresholds.PRIOR_SHARE * abs(value))
    }


def points(rows: Iterable[HourRow]) -> dict[str, list[trends.Point]]:
    """Return the courses of the quantities: a point in the middle of each hour that shows them."""
    found = defaultdict[str, list[trends.Point]](list)
    for row in rows:
        for name, shown in row.means.items():
            time_s = row.time.astimezone(UTC).timestamp() + 0.5 * HOUR_S
            found[name].append(trends.Point(time_s, *shown))
    return found


# What the rows say: the report, and the bounds that were crossed.


def report(rows: Sequence[HourRow], weeks: float = 8.0) -> trends.HealthReport | None:
    """Return the condition of a load, None before the first hour.

    Args:
        rows: Its rows.
        weeks: Time over which trends and changes are sought and shown.
    """
    if not rows:
        return None
    since_s = rows[-1].time.timestamp() - weeks * trends.WEEK_S
    courses = {name: trends.daily(found) for name, found in points(rows).items()}
    shown = {name: trends.shares(courses[name]) for name in trends.MEANINGS if name in courses}
    times_s = sorted({one for found in shown.values() for one in found if one >= since_s})
    changed = ((row.time, dict.fromkeys(row.changes)) for row in rows if row.changes)
    return trends.HealthReport(
        time=rows[-1].time,
        running_h=round(math.fsum(one.running_h for one in rows), 3),
        starts=sum(one.starts for one in rows),
        quantities={
            name: trends.condition(name, found, since_s, outside=name in rows[-1].outside)
            for name, found in courses.items()
        },
        times_s=tuple(times_s),
        courses={name: tuple(map(found.get, times_s)) for name, found in shown.items()},
        changes=tuple(f"{at:%Y-%m-%dT%H}Z {', '.join(what)}" for at, what in changed)[-7:],
    )


_PATIENCE_S = 4.0 * trends.WEEK_S
_KNOWN_DAYS = 10
"""Days with an estimate, of four weeks, before a bound can be left."""

_MOST_HOURS = round((_PATIENCE_S + trends.DAY_S) / HOUR_S)


def update(directory: Path, settings: records.HealthSettings) -> tuple[list[HourRow], list[Event]]:
    """Append the rows that a session has more than the file of its drive.

    Args:
        directory: Directory of the session.
        settings: What gives its estimates their meaning, and the bounds.

    Returns:
        All rows of the drive, and the bounds that were crossed.

    Raises:
        RecordingError: The session cannot be read.
        OSError: The rows cannot be written.
    """
    info = read_info(directory)
    path = health_path(directory.parent, info.drive)
    rows = read_rows(path)
    own = [one.time for one in rows if one.session == info.started]
    new = session_rows(directory, info, settings, max(own, default=None))
    if not new:
        return rows, []
    outside, events = crossings([*rows, *new], rows[-1].outside if rows else (), settings)
    new = [msgspec.structs.replace(one, outside=outside) for one in new]
    append_rows(path, new)
    return [*rows, *new], events


def crossings(
    rows: Sequence[HourRow], before: Sequence[str], settings: records.HealthSettings
) -> tuple[tuple[str, ...], list[Event]]:
    """Return the quantities that are outside their bounds, and an event for each that crossed one.

    A bound counts as left where the mean of the last seven complete days is beyond it by six
    standard deviations, and as kept again where it is within it by as many.

    Args:
        rows: Rows of the drive, the newest of a day that is not complete.
        before: Quantities that were outside.
        settings: The bounds.
    """
    courses, outside, events = points(rows[-_MOST_HOURS:]), list[str](), list[Event]()
    for name, (low, high) in settings.bounds.items():
        is_outside = was_outside = name in before
        if (level := bound_level(courses.get(name, []))) is not None:
            value, margin = level[0], trends.SIGMAS * level[1]
            kept = low + margin <= value <= high - margin
            left = not low - margin <= value <= high + margin
            is_outside = left or (was_outside and not kept)
            if is_outside != was_outside:
                severity = Severity.WARNING if is_outside else Severity.INFO
                events.append(Event("health", severity, _sentence(name, level, (low, high)), -1))
        outside += [name] if is_outside else []
    return tuple(outside), events


def bound_level(points: Sequence[trends.Point]) -> Mean | None:
    """Return the mean of the last seven complete days and its deviation; None where few are known.

    Args:
        points: The hours, the newest of which is of a day that is not complete.
    """
    today_s = trends.DAY_S * (points[-1].time_s // trends.DAY_S) if points else math.nan
    days = trends.daily(one for one in points if today_s - _PATIENCE_S <= one.time_s < today_s)
    line, step = trends.fit_line(days), trends.find_step(days)
    if line is None or len(days) < _KNOWN_DAYS:
        return None
    return trends.mean(days[-trends.DAYS :], line.factor if step is None else step[1].factor)


def _sentence(name: str, level: Mean, bounds: tuple[float, float]) -> str:
    (value, std), (low, high) = level, bounds
    limit = f"above its bound of {high:.4g}" if value > high else "within its bounds again"
    limit = f"below its bound of {low:.4g}" if value < low else limit
    what = f"{trends.MEANINGS.get(name, name)}: {name} = {value:.5g} ± {std:.2g}"
    return f"{what}, over the last {trends.DAYS} days, {limit}"
