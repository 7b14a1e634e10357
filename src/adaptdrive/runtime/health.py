"""The health of a load, as operators see it."""

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True, slots=True)
class HealthQuantity:
    """One quantity of a load over the weeks.

    Attributes:
        value: Mean of the last seven days with an estimate; in the first two weeks of hours.
        std: Its standard deviation.
        change_percent: Its change since the first seven days.
        change_std: Standard deviation of that.
        trend_percent: Rise a week over the last eight weeks, of the first seven days.
        trend_std: Standard deviation of that.
        nominal: Value that follows from `[load.model]`.
        since: Time of a sudden change, None without one.
        step_percent: That change.
        step_std: Standard deviation of that.
        outside: Whether it has left its bounds in `[health]`.
    """

    value: float
    std: float
    change_percent: float | None
    change_std: float | None
    trend_percent: float | None
    trend_std: float | None
    nominal: float | None
    since: datetime | None
    step_percent: float | None
    step_std: float | None
    outside: bool


@dataclass(frozen=True, slots=True)
class HealthReport:
    """The health of a load: what its estimates were over the weeks.

    Attributes:
        time: Begin of the newest hour.
        running_h: Time that the load was fed, of all hours.
        starts: How often that began.
        quantities: Each quantity by name.
        times_s: Times of the last 200 days, or hours, in seconds since 1970.
        courses: Values at these times by name, None where the load has shown none.
        changes: The last hours in which the bank of models decided on a change, and on which.
    """

    time: datetime
    running_h: float
    starts: int
    quantities: dict[str, HealthQuantity]
    times_s: tuple[float, ...]
    courses: dict[str, tuple[float | None, ...]]
    changes: tuple[str, ...]
