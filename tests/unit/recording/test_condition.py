"""What months of hours say of a load: trends and steps within their uncertainty, no false warning.

The months are drawn from the errors that hours of the real estimator have, held to it below, with
what no estimator knows added: days that differ, and hours that resemble each other.
"""

from __future__ import annotations

import math
from datetime import timedelta

import msgspec
import numpy as np
import pytest

from adaptdrive.recording import condition, health
from adaptdrive.recording.health import HourRow, Mean
from adaptdrive.recording.records import HealthSettings, slow_row
from adaptdrive.runtime.health import HealthQuantity
from adaptdrive.util import trends
from tests.unit.recording.months import BEGIN, HOURS, SETTINGS, TRUTH, months, motor_hours


def friction(rows: list[HourRow], weeks: float = 8.0) -> HealthQuantity:
    report = condition.report(rows, SETTINGS, weeks)
    assert report is not None
    return report.quantities["friction"]


@pytest.fixture(scope="module")
def hours() -> list[HourRow]:
    """Rows of the real estimator: eight half hours, each of another run."""
    rows = []
    for seed in range(8):
        hour = health._Hour()
        for step in motor_hours(0.5, seed):
            health._add(hour, slow_row(step), SETTINGS)
        rows.append(health._row(BEGIN, BEGIN, hour, SETTINGS))
    return rows


def test_the_deviation_of_an_hour_is_that_of_the_real_estimator(hours: list[HourRow]) -> None:
    for name, true in TRUTH.items():
        points = [
            point for row in hours for point in condition.spans_of(health.points([row])[name])
        ]
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
        assert found.step_percent is not None
        assert found.step_std is not None
        assert abs(found.since - BEGIN - timedelta(weeks=5)) <= timedelta(days=1)
        off.append((found.step_percent - 8.0) / found.step_std)
    assert max(map(abs, off)) < 3.0


def test_a_constant_load_shows_neither_trend_nor_step() -> None:
    shown = [friction(months(8.0, seed)) for seed in range(40)]
    assert all(one.since is None for one in shown)
    off = [
        one.trend_percent / one.trend_std for one in shown if one.trend_std and one.trend_percent
    ]
    assert max(map(abs, off)) < 4.0


def warnings(rows: list[HourRow], settings: HealthSettings) -> list[health.BoundRow]:
    """The crossings of months whose archiver runs once a day."""
    known: list[health.Row] = []
    found: list[health.BoundRow] = []
    for number, row in enumerate(rows, 1):
        known.append(row)
        if number % len(HOURS) == 0:
            recent = [*known[-35 * len(HOURS) :], *found]
            new = [one.row for one in condition.crossings(recent, settings)]
            found += new
    return found


def bounded(low: float | None, high: float | None) -> HealthSettings:
    true = TRUTH["friction"]
    limits = tuple(None if one is None else one * true for one in (low, high))
    return msgspec.structs.replace(SETTINGS, bounds={"friction": limits})


@pytest.mark.parametrize("high", [1.0, 1.01])
def test_a_constant_load_gives_no_false_warning_in_ten_years(high: float) -> None:
    """With a bound that is nearer than the scatter of its days, too."""
    assert warnings(months(522.0, 1), bounded(None, high)) == []


def test_an_estimate_that_is_repeated_gives_no_false_warning_in_ten_years() -> None:
    """A load that moves as predicted teaches nothing, for ten days on average."""
    random, rows = np.random.default_rng(5), months(522.0, 1)
    error, due = 0.0, 0
    for place, row in enumerate(rows):
        new = place >= due
        if new:
            error, due = 0.03 * random.normal(), place + round(random.exponential(100.0)) + 1
        value = TRUTH["friction"] * (1.0 + error)
        mean = Mean(value, 0.03 * TRUTH["friction"], float(new))
        rows[place] = msgspec.structs.replace(row, means={"friction": mean})
    assert warnings(rows, bounded(None, 1.0)) == []


def test_a_bound_is_left_once_and_kept_again_once() -> None:
    def course(week: float) -> float:
        return 1.0 + 0.01 * min(week, 40.0 - week)

    found = warnings(months(40.0, 3, course), bounded(0.5, 1.1))
    assert [one.outside for one in found] == [True, False]
    weeks = [(one.time - BEGIN) / timedelta(weeks=1) for one in found]
    assert 10.0 < weeks[0] < 14.0
    assert 30.0 < weeks[1] < 34.0
    assert condition.outsiders([*months(1.0, 3), *found[:1]]) == {"friction"}


def test_what_a_change_means_is_said_in_words() -> None:
    rows = months(8.0, 2, lambda week: 1.08 if week >= 5.0 else 1.0)
    report = condition.report(rows, SETTINGS)
    assert report is not None
    (sentence,) = condition.sentences(report)
    assert sentence.startswith("dry friction and load torque up 8")
    assert sentence.endswith("% since Mon 2026-02-09")


def test_a_line_is_that_of_weighted_least_squares() -> None:
    """numpy's, with the weights that the scatter of the points leaves."""
    random = np.random.default_rng(4)
    x = np.arange(30.0)
    std = random.choice([0.5, 1.0, 2.0], 30)
    y = 3.0 + 0.2 * x + random.normal(size=30) * np.hypot(std, 1.5)
    fit = trends.fit_line([trends.Point(*one) for one in zip(x, y, std, strict=True)])
    assert fit is not None
    weights = 1.0 / np.hypot(std, fit.spread)
    (slope, _), spread = np.polyfit(x, y, 1, w=weights, cov="unscaled")
    assert fit.slope == pytest.approx(slope)
    assert fit.std == pytest.approx(fit.factor * math.sqrt(spread[0, 0]))
    assert 0.8 < fit.spread < 2.5
