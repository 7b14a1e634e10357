"""What months of hours say of a load: trends and steps within their uncertainty, no false warning.

The months are drawn from the errors that hours of the real estimator have, held to it below, with
what no estimator knows added: days that differ, and hours that resemble each other.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta

import msgspec
import numpy as np
import pytest

from adaptdrive.recording import health
from adaptdrive.recording.health import HourRow
from adaptdrive.recording.records import HealthSettings, slow_row
from adaptdrive.runtime.reports import Event, Severity
from adaptdrive.util import trends
from adaptdrive.util.trends import HealthQuantity
from tests.unit.recording.months import BEGIN, HOURS, SETTINGS, TRUTH, months, motor_hours


def friction(rows: list[HourRow], weeks: float = 8.0) -> HealthQuantity:
    report = health.report(rows, weeks)
    assert report is not None
    return report.quantities["friction"]


@pytest.fixture(scope="module")
def hours() -> list[HourRow]:
    """Rows of the real estimator: eight half hours, each of another run."""
    rows = []
    for seed in range(8):
        means = health._means(map(slow_row, motor_hours(0.5, seed)), SETTINGS)
        rows.append(HourRow(BEGIN, BEGIN, 0.5, 1, means))
    return rows


def test_the_deviation_of_an_hour_is_that_of_the_real_estimator(hours: list[HourRow]) -> None:
    for name, true in TRUTH.items():
        points = [point for row in hours for point in health.points([row])[name]]
        off = [(one.value - true) / one.std for one in points]
        assert len(points) == len(hours)
        assert math.sqrt(np.mean(np.square(off))) < 2.0, name
        assert max(map(abs, off)) < 5.0, name


def test_friction_that_rises_1_percent_a_week_is_found_within_its_uncertainty() -> None:
    off = []
    for seed in range(40):
        found = friction(months(12.0, seed, lambda week: 1.0 + 0.01 * week), weeks=12.0)
        assert found.trend_percent is not None
        assert found.trend_std is not None
        assert found.since is None
        assert found.trend_percent > 5.0 * found.trend_std
        off.append((found.trend_percent - 1.0) / found.trend_std)
    assert math.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.35)
    assert max(map(abs, off)) < 4.0


def test_another_load_is_a_step_at_its_day() -> None:
    off = []
    for seed in range(10):
        found = friction(months(8.0, seed, lambda week: 1.08 if week >= 5.0 else 1.0))
        assert found.since is not None
        assert found.trend_percent is None
        assert found.change_percent is not None
        assert found.change_std is not None
        assert abs(found.since - BEGIN - timedelta(weeks=5)) <= timedelta(days=1)
        off.append((found.change_percent - 8.0) / found.change_std)
    assert max(map(abs, off)) < 3.0


def test_a_constant_load_shows_neither_trend_nor_step() -> None:
    shown = [friction(months(8.0, seed)) for seed in range(40)]
    assert all(one.since is None for one in shown)
    off = [
        one.trend_percent / one.trend_std for one in shown if one.trend_std and one.trend_percent
    ]
    assert max(map(abs, off)) < 4.0


def warnings(rows: list[HourRow], settings: HealthSettings) -> list[tuple[datetime, Event]]:
    """The crossings of months whose archiver runs once a day, and their times."""
    found: list[tuple[datetime, Event]] = []
    outside: tuple[str, ...] = ()
    for number in range(len(HOURS), len(rows) + 1, len(HOURS)):
        recent = rows[max(0, number - 35 * len(HOURS)) : number]
        outside, events = health.crossings(recent, outside, settings)
        found += [(recent[-1].time, one) for one in events]
    return found


def bounded(low: float, high: float) -> HealthSettings:
    true = TRUTH["friction"]
    limits = low * true, high * true
    return msgspec.structs.replace(SETTINGS, bounds={"friction": limits})


@pytest.mark.parametrize("high", [1.0, 1.01])
def test_a_constant_load_gives_no_false_warning_in_ten_years(high: float) -> None:
    """With a bound that is nearer than the scatter of its days, too."""
    assert warnings(months(522.0, 1), bounded(-math.inf, high)) == []


def test_an_estimate_that_is_repeated_gives_no_false_warning_in_ten_years() -> None:
    """A load that moves as predicted teaches nothing, for two days on average."""
    random, rows = np.random.default_rng(5), months(522.0, 1)
    for place, row in enumerate(rows):
        value = TRUTH["friction"] * (1.0 + 0.03 * random.normal())
        shown = {"friction": (value, 0.03 * TRUTH["friction"])} if random.random() < 0.05 else {}
        rows[place] = msgspec.structs.replace(row, means=shown)
    assert warnings(rows, bounded(-math.inf, 1.0)) == []


def test_a_bound_is_left_once_and_kept_again_once() -> None:
    def course(week: float) -> float:
        return 1.0 + 0.01 * min(week, 40.0 - week)

    found = warnings(months(40.0, 3, course), bounded(0.5, 1.1))
    assert [one.severity for _, one in found] == [Severity.WARNING, Severity.INFO]
    weeks = [(time - BEGIN) / timedelta(weeks=1) for time, _ in found]
    assert 10.0 < weeks[0] < 14.0
    assert 30.0 < weeks[1] < 34.0


def test_what_a_change_means_is_said_in_words() -> None:
    rows = months(8.0, 2, lambda week: 1.08 if week >= 5.0 else 1.0)
    sentence = friction(rows).meaning
    assert sentence.startswith("dry friction and load torque up 8")
    assert sentence.endswith("% since Mon 2026-02-09")


def test_a_line_is_that_of_weighted_least_squares() -> None:
    """numpy's, wider by what neighbours have in common."""
    random = np.random.default_rng(4)
    x = np.arange(30.0)
    std = random.choice([0.5, 1.0, 2.0], 30)
    y = 3.0 + 0.2 * x + random.normal(size=30) * 1.5 * std
    fit = trends.fit_line([trends.Point(*one) for one in zip(x, y, std, strict=True)])
    assert fit is not None
    (slope, level), spread = np.polyfit(x, y, 1, w=1.0 / std, cov=True)
    off = (y - slope * x - level) / std
    alike = max(0.0, float(off[1:] @ off[:-1] / (off @ off)))
    assert fit.slope == pytest.approx(slope)
    wider = (1.0 + alike) / (1.0 - alike)
    assert fit.std == pytest.approx(math.sqrt(spread[0, 0] * wider))
