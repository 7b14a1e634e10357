"""Courses of quantities over weeks: their days, a line or a step through them, and what it means.

The days are what is compared: a level is a mean of seven, a baseline that of the first seven. Days
that scatter by more than their deviations widen these by √(χ²/(n - 2)), and residuals that resemble
their neighbours, with the correlation φ, by √((1 + φ)/(1 - φ)).
"""

import itertools
import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

DAY_S = 86_400.0
WEEK_S = 7.0 * DAY_S

DAYS = 7
"""Days of a level."""

FEWEST = 4
"""Days of a line: two more than it has parameters."""

SIGMAS = 6.0
"""Standard deviations by which a bound is left, and by which a step stands out."""

_SIDE = 3
"""Least days on each side of a step."""

_CLEAR = 20.0
"""n ln(χ²/χ²) by which a step must explain days better than a line: odds of e^10 to 1."""

_MOST_ALIKE = 0.9
"""Largest correlation of neighbours that few days can show."""

_LEAST = 1e-300

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


@dataclass(frozen=True, slots=True)
class Point:
    """A value at a time, with its standard deviation."""

    time_s: float
    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Fit:
    """A straight line through points over their places, such as their times.

    Attributes:
        slope: Rise for each unit of the places.
        std: Its standard deviation.
        loss: χ², the sum of the squared residuals, each in deviations of its point.
        factor: Factor by which their scatter widens deviations.
    """

    slope: float
    std: float
    loss: float
    factor: float


@dataclass(frozen=True, slots=True)
class HealthQuantity:
    """One quantity of a load over the weeks.

    Attributes:
        value: Mean of the last seven days with an estimate.
        std: Its standard deviation.
        change_percent: Its change since a sudden one, else since the first seven days.
        change_std: Standard deviation of that.
        trend_percent: Rise a week, of the first seven days; None where it changed suddenly.
        trend_std: Standard deviation of that.
        since: Time of a sudden change, None without one.
        meaning: What stands out, such as `inertia up 8 ± 1 % since Tue 2026-11-24`; else empty.
        outside: Whether it has left its bounds in `[health]`.
    """

    value: float
    std: float
    change_percent: float | None
    change_std: float | None
    trend_percent: float | None
    trend_std: float | None
    since: datetime | None
    meaning: str
    outside: bool


@dataclass(frozen=True, slots=True)
class HealthReport:
    """The health of a load: what its estimates were over the weeks.

    Attributes:
        time: Begin of the newest hour.
        running_h: Time that the load was fed, of all hours.
        starts: How often that began.
        quantities: Each quantity by name.
        times_s: Times of the days shown, in seconds since 1970.
        courses: Changes since the first seven days at these times in %, by name; None where the
            load has shown none.
        changes: The last hours in which the bank of models decided on a change, and on which.
    """

    time: datetime
    running_h: float
    starts: int
    quantities: dict[str, HealthQuantity]
    times_s: tuple[float, ...]
    courses: dict[str, tuple[float | None, ...]]
    changes: tuple[str, ...]


def daily(points: Iterable[Point]) -> list[Point]:
    """Return the weighted mean of each day that has points, in the middle of the day.

    Args:
        points: In the order of their times.
    """
    days = itertools.groupby(points, lambda one: one.time_s // DAY_S)
    return [Point((day + 0.5) * DAY_S, *mean(list(found))) for day, found in days]


def mean(points: Sequence[Point], factor: float = 1.0) -> tuple[float, float]:
    """Return the weighted mean of points, one at least, and its standard deviation.

    Args:
        points: The points.
        factor: As of `Fit`.
    """
    weights = _weights(points)
    return _mean([one.value for one in points], weights), factor / math.sqrt(math.fsum(weights))


def fit_line(points: Sequence[Point]) -> Fit | None:
    """Return the line through points over their times, None for fewer than four."""
    return _fit(points, [one.time_s for one in points]) if len(points) >= FEWEST else None


def find_step(points: Sequence[Point]) -> tuple[float, Fit] | None:
    """Return the step that explains points clearly better than a line: its time, and its fit.

    Args:
        points: In the order of their times.
    """
    line, found = fit_line(points), []
    for place in range(_SIDE, len(points) - _SIDE + 1):
        fit = _fit(points, [float(number >= place) for number in range(len(points))])
        found.append((fit.loss, points[place].time_s, fit))
    if line is None or not found:
        return None
    loss, time_s, fit = min(found)
    clear = len(points) * math.log((line.loss + _LEAST) / (loss + _LEAST)) > _CLEAR
    return (time_s, fit) if clear and abs(fit.slope) > SIGMAS * fit.std else None


def _weights(points: Sequence[Point]) -> list[float]:
    return [1.0 / max(one.std * one.std, _LEAST) for one in points]


def _mean(values: Sequence[float], weights: Sequence[float]) -> float:
    return math.fsum(map(operator.mul, values, weights)) / math.fsum(weights)


def _fit(points: Sequence[Point], places: Sequence[float]) -> Fit:
    """Return the line of weighted least squares."""
    weights, values = _weights(points), [one.value for one in points]
    middle, level = _mean(places, weights), _mean(values, weights)
    rows = [(w, x - middle, y - level) for w, x, y in zip(weights, places, values, strict=True)]
    moment = math.fsum(w * x * x for w, x, _ in rows)
    slope = math.fsum(w * x * y for w, x, y in rows) / moment
    residuals = [math.sqrt(w) * (y - slope * x) for w, x, y in rows]
    loss = math.fsum(one * one for one in residuals)
    alike = math.fsum(one * other for one, other in itertools.pairwise(residuals))
    alike = min(max(0.0, alike / (loss + _LEAST)), _MOST_ALIKE)
    scatter = max(1.0, loss / (len(points) - 2)) * (1.0 + alike) / (1.0 - alike)
    return Fit(slope, math.sqrt(scatter / moment), loss, math.sqrt(scatter))


def condition(
    name: str, course: Sequence[Point], since_s: float, *, outside: bool
) -> HealthQuantity:
    """Return the condition of a quantity.

    Args:
        name: Its name.
        course: Its days.
        since_s: Time from which a line or a step is sought.
        outside: Whether it has left its bounds.
    """
    recent = [one for one in course if one.time_s >= since_s] or course[-1:]
    line, (step_s, step) = fit_line(recent), find_step(recent) or (-math.inf, None)
    factor = step.factor if step else line.factor if line else 1.0
    value, std = mean([one for one in recent if one.time_s >= step_s][-DAYS:], factor)
    base, base_std = mean(course[:DAYS], factor)
    scale, change, trend = 100.0 / (abs(base) or math.nan), (math.nan, math.nan), (math.nan,) * 2
    if step:
        change = step.slope * scale, step.std * scale
    elif len(course) > DAYS:
        change = (value - base) * scale, math.hypot(std, base_std) * scale
    if line and not step:
        trend = line.slope * WEEK_S * scale, line.std * WEEK_S * scale
    since = datetime.fromtimestamp(step_s, UTC) if step else None
    return HealthQuantity(
        value=value,
        std=std,
        change_percent=_known(change[0]),
        change_std=_known(change[1]),
        trend_percent=_known(trend[0]),
        trend_std=_known(trend[1]),
        since=since,
        meaning=_meaning(MEANINGS.get(name, ""), change, trend, since),
        outside=outside,
    )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _meaning(
    what: str, change: tuple[float, ...], trend: tuple[float, ...], since: datetime | None
) -> str:
    percent, std = change if since else trend
    if not (what and abs(percent) > 0.5 * SIGMAS * std):
        return ""
    moved = f"{what} {'up' if percent > 0.0 else 'down'} {abs(percent):.2g} ± {std:.1g} %"
    return f"{moved} since {since:%a %Y-%m-%d}" if since else f"{moved} a week"


def shares(course: Sequence[Point]) -> dict[float, float | None]:
    """Return the changes of days since the first seven in %, by their times."""
    base = mean(course[:DAYS])[0]
    scale = 100.0 / (abs(base) or math.nan)
    return {one.time_s: _known((one.value - base) * scale) for one in course}
