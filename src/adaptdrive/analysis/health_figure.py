"""The health of a load as a figure: each quantity over the weeks, with its line and its step."""

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptdrive.analysis import figures
from adaptdrive.recording import condition, health
from adaptdrive.recording.records import HealthSettings
from adaptdrive.runtime.health import HealthQuantity
from adaptdrive.util import trends

_ROW_in = 1.35
_BAND = 2.0


def draw_health(drive: str, rows: Sequence[health.Row], weeks: float) -> bytes:
    """Draw the condition of a load.

    Args:
        drive: Name of the drive.
        rows: Its rows, an hour at least.
        weeks: Time that is shown.

    Returns:
        A PNG.
    """
    courses = {name: condition.spans_of(found) for name, found in health.points(rows).items()}
    found = condition.report(rows, HealthSettings(), weeks)
    shown = {n: c for n, c in courses.items() if n in condition.MEANINGS} or courses
    newest_s = max((course[-1].time_s for course in shown.values()), default=0.0)
    with figures.journal():
        size = figures.WIDTH_in, _ROW_in * max(1, len(shown)) + 0.4
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(max(1, len(shown)), 1, sharex=True, squeeze=False)[:, 0]
        for one, (name, course) in zip(axes, shown.items(), strict=False):
            recent = [p for p in course if p.time_s > newest_s - weeks * condition.WEEK_S]
            if found is not None and recent:
                title = condition.MEANINGS.get(name, name)
                base = trends.mean(course[: condition.SPANS])[0] or 1.0
                _draw(one, f"{drive}: {title}", recent, base, found.quantities[name])
        axes[-1].set_xlabel("UTC")
        axes[-1].tick_params(axis="x", labelrotation=20)
        return figures.as_png(figure)


def _draw(
    axes: Axes,
    title: str,
    course: Sequence[trends.Point],
    base: float,
    quantity: HealthQuantity,
) -> None:
    """Draw one quantity in per cent of its first days, with its step or its line."""
    times_s = np.array([one.time_s for one in course])
    times = np.array([datetime.fromtimestamp(time_s, UTC) for time_s in times_s])
    values = np.array([100.0 * (one.value - base) / abs(base) for one in course])
    spreads = np.array([_BAND * 100.0 * one.std / abs(base) for one in course])
    axes.errorbar(times, values, spreads, fmt=".", color=figures.ADAPTIVE["color"], elinewidth=0.6)
    if quantity.since is not None:
        before = times_s < quantity.since.timestamp()
        for side in (before, ~before):
            axes.plot(times[side], np.full(side.sum(), values[side].mean()), **figures.FIXED)
        title += (
            f" {quantity.step_percent:+.2g} ± {quantity.step_std:.1g} % since {quantity.since:%F}"
        )
    elif quantity.trend_percent is not None:
        rise = quantity.trend_percent * (times_s - times_s.mean()) / condition.WEEK_S
        axes.plot(times, np.average(values - rise, weights=spreads**-2.0) + rise, **figures.FIXED)
        title += f" {quantity.trend_percent:+.2g} ± {quantity.trend_std:.1g} % a week"
    axes.set_title(title)
    axes.set_ylabel("%")
