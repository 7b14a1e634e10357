"""The condition of a load from its rows: level, trend, change and bounds of each quantity.

The days are what is compared: a level is a mean over seven, a baseline that of the first seven with
an estimate, a trend a line over eight weeks. In the first two weeks hours take the place of days.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from adaptdrive.recording import health
from adaptdrive.recording.records import HealthSettings
from adaptdrive.runtime.health import HealthQuantity, HealthReport
from adaptdrive.util import trends

DAY_S = 86_400.0
WEEK_S = 7.0 * DAY_S

SPANS = 7
"""Days of a level."""

_MOST_SHOWN = 200
"""Days of the course that a page shows."""

SIGMAS = 6.0
"""Standard deviations by which a bound is left, and by which a step stands out."""

_KNOWN_DAYS = 10
"""Days with an estimate, of four weeks, before a bound can be left."""

_PATIENCE_S = 4.0 * WEEK_S

MEANINGS = {
    "inertia": "inertia",
    "damping": "damping: viscous friction and back-EMF",
    "friction": "dry friction and load torque",
    "heat_capacity": "heat capacity",
    "conductance": "conductance to the surroundings",
    "heat_loss": "heat lost whatever the temperature",
    "series_resistance": "series resistance",
    "resistance": "resistance at rest",
    "emf": "EMF",
}
"""Quantities that say more of a load than the parameter that they follow from."""


_SHORT_S = health.HOUR_S, 6.0 * health.HOUR_S
_MOST_SPANS = 56
"""Spans that eight weeks have, after which longer ones follow."""

_FIRST = 28
"""Days whose scatter is that of a baseline."""


def spans_of(points: Sequence[trends.Point]) -> list[trends.Point]:
    """Return a point for each day; while there are few of them, for each hour or six."""
    lasted_s = points[-1].time_s - points[0].time_s if points else 0.0
    widths_s = (width_s for width_s in _SHORT_S if lasted_s < _MOST_SPANS * width_s)
    return trends.pooled(points, next(widths_s, DAY_S))


def report(
    rows: Sequence[health.Row], settings: HealthSettings, weeks: float = 8.0
) -> HealthReport | None:
    """Return the condition of a load, None before the first hour.

    Args:
        rows: Its rows.
        settings: What gives its estimates their meaning.
        weeks: Time over which trends and changes are sought.
    """
    hours = [one for one in rows if isinstance(one, health.HourRow)]
    if not hours:
        return None
    outside = outsiders(rows)
    courses = {name: spans_of(found) for name, found in health.points(hours).items()}
    times_s = sorted({one.time_s for found in courses.values() for one in found})[-_MOST_SHOWN:]
    values = {name: {p.time_s: p for p in found} for name, found in courses.items()}
    return HealthReport(
        time=hours[-1].time,
        running_h=round(math.fsum(one.running_h for one in hours), 3),
        starts=sum(one.starts for one in hours),
        quantities={
            name: _quantity(found, weeks, settings.nominal.get(name), outside=name in outside)
            for name, found in courses.items()
        },
        times_s=tuple(times_s),
        courses={
            name: tuple(found[time_s].value if time_s in found else None for time_s in times_s)
            for name, found in values.items()
        },
        changes=tuple(
            f"{row.time:%Y-%m-%dT%H}Z {', '.join(dict.fromkeys(row.changes))}"
            for row in hours
            if row.changes
        )[-SPANS:],
    )


def _quantity(
    course: Sequence[trends.Point], weeks: float, nominal: float | None, *, outside: bool
) -> HealthQuantity:
    """Return the condition of one quantity from its spans."""
    recent = [one for one in course if one.time_s > course[-1].time_s - weeks * WEEK_S]
    line, step = trends.fit_line(recent), trends.find_step(recent, SIGMAS)
    ends = [one for one in recent if step is None or one.time_s >= step.time_s]
    begins = [one for one in course if step is None or one.time_s < step.time_s]
    level, std = _mean(ends[-SPANS:], trends.fit_line(ends))
    base, base_std = _mean(begins[:SPANS], trends.fit_line(begins[:_FIRST]))
    apart = len(course) > SPANS
    scale = 100.0 / abs(base) if base else math.nan
    week = WEEK_S * scale
    return HealthQuantity(
        value=level,
        std=std,
        change_percent=_known((level - base) * scale if apart else math.nan),
        change_std=_known(math.hypot(std, base_std) * abs(scale) if apart else math.nan),
        trend_percent=_known(line.slope * week if line else math.nan),
        trend_std=_known(line.std * week if line else math.nan),
        nominal=nominal,
        since=None if step is None else datetime.fromtimestamp(step.time_s, UTC),
        step_percent=None if step is None else _known(step.change * scale),
        step_std=None if step is None else _known(step.std * abs(scale)),
        outside=outside,
    )


def _mean(points: Sequence[trends.Point], line: trends.Fit | None) -> tuple[float, float]:
    return trends.mean(points, line.spread, line.factor) if line else trends.mean(points)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def sentences(found: HealthReport) -> Iterator[str]:
    """Yield what the condition means, such as `inertia up 8 ± 1 % since Tue 2026-11-24`."""
    for name, meaning in MEANINGS.items():
        one = found.quantities.get(name)
        if one is None:
            continue
        if one.since is not None and one.step_percent is not None:
            moved = _moved(one.step_percent, one.step_std)
            yield f"{meaning} {moved} since {one.since:%a %Y-%m-%d}"
        elif _stands_out(one.trend_percent, one.trend_std):
            yield f"{meaning} {_moved(one.trend_percent, one.trend_std)} a week"


def _stands_out(value: float | None, std: float | None) -> bool:
    return value is not None and std is not None and abs(value) > 0.5 * SIGMAS * std


def _moved(percent: float | None, std: float | None) -> str:
    value, spread = percent or 0.0, std or 0.0
    return f"{'up' if value > 0.0 else 'down'} {abs(value):.2g} ± {spread:.1g} %"


# Bounds.


@dataclass(frozen=True, slots=True)
class Crossing:
    """A bound that was crossed.

    Attributes:
        row: The row that keeps it.
        text: One sentence.
    """

    row: health.BoundRow
    text: str


def outsiders(rows: Sequence[health.Row]) -> set[str]:
    """Return the quantities that have left their bounds and not come back."""
    last = {one.name: one.outside for one in rows if isinstance(one, health.BoundRow)}
    return {name for name, outside in last.items() if outside}


def crossings(rows: Sequence[health.Row], settings: HealthSettings) -> list[Crossing]:
    """Return the bounds that were crossed since the last crossings among the rows.

    A bound counts as left where the mean of the last seven complete days is beyond it by six
    standard deviations, and as kept again where it is within it by as many.

    Args:
        rows: Rows of the drive.
        settings: The bounds.
    """
    hours, found = [one for one in rows if isinstance(one, health.HourRow)], []
    courses, outside = health.points(hours[-_most_hours() :]), outsiders(rows)
    for name, bounds in settings.bounds.items():
        level = bound_level(courses.get(name, []))
        verdict = None if level is None else _is_outside(*level, bounds)
        if level is not None and verdict is not None and verdict != (name in outside):
            row = health.BoundRow(hours[-1].time, name, verdict)
            found.append(Crossing(row, _sentence(name, level, settings, outside=verdict)))
    return found


def _most_hours() -> int:
    return round((_PATIENCE_S + DAY_S) / health.HOUR_S)


def bound_level(points: Sequence[trends.Point]) -> tuple[float, float] | None:
    """Return the mean of the last seven complete days and its deviation; None where few are known.

    Args:
        points: The hours, the newest of which is of a day that is not complete.
    """
    if not points:
        return None
    today_s = DAY_S * (points[-1].time_s // DAY_S)
    since_s = today_s - _PATIENCE_S
    days = trends.pooled([one for one in points if since_s <= one.time_s < today_s], DAY_S)
    last = [one for one in days if one.time_s > today_s - SPANS * DAY_S]
    line = trends.fit_line(days)
    if line is None or len(days) < _KNOWN_DAYS or len(last) < trends.FEWEST:
        return None
    return trends.mean(last, line.spread, line.factor)


def _is_outside(value: float, std: float, bounds: tuple[float | None, float | None]) -> bool | None:
    """Return whether a level is beyond its bounds, None where that is not sure."""
    low = -math.inf if bounds[0] is None else bounds[0]
    high = math.inf if bounds[1] is None else bounds[1]
    if value - SIGMAS * std > high or value + SIGMAS * std < low:
        return True
    if low <= value - SIGMAS * std and value + SIGMAS * std <= high:
        return False
    return None


def _sentence(
    name: str, level: tuple[float, float], settings: HealthSettings, *, outside: bool
) -> str:
    value, std = level
    low, high = settings.bounds[name]
    limit = f"above its bound of {high:.4g}" if high is not None else ""
    if low is not None and (high is None or value < low):
        limit = f"below its bound of {low:.4g}"
    nominal = settings.nominal.get(name)
    share = f", {value / nominal:.4g} of load.model" if nominal else ""
    what = f"{MEANINGS.get(name, name)}: {name} = {value:.5g} ± {std:.2g}{share}"
    return f"{what}, over the last {SPANS} days, {limit if outside else 'within its bounds again'}"
