"""Each limit of time, as it follows from the times of a drive: docs/proof/obedience.md."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.safety.timing import Timing
from tools.pages.limits_table import with_table

CHECKOUT = Path(__file__).parents[3]

EACH = Timing(half_cycle_s=0.01, stale_s=0.05)
POLLED = Timing(half_cycle_s=0.01, stale_s=0.35, ticks_per_reading=20)


def about(value: float) -> object:
    return pytest.approx(value, rel=1e-12)


def test_limits_of_a_drive_that_sends_each_half_cycle() -> None:
    assert math.inf == EACH.certain_s
    assert (EACH.silent_s, EACH.unseen_s, EACH.asleep_s) == (0.08, 0.08, 0.08)
    assert (EACH.overslept_s, EACH.switched_on_s, EACH.switched_off_s) == (0.05, about(0.3), 0.5)
    assert (EACH.command_pause_s, EACH.usual_s) == (about(0.025), about(0.015))


def test_limits_of_a_drive_that_is_polled() -> None:
    assert (POLLED.silent_s, POLLED.unseen_s, POLLED.asleep_s) == (0.5, 0.08, 0.4)
    assert (POLLED.overslept_s, POLLED.frozen_s) == (0.4, 0.4)
    assert (POLLED.switched_on_s, POLLED.switched_off_s) == (about(0.6), 0.8)
    assert POLLED.taken_s == about(1.2)


@pytest.mark.parametrize(
    ("timeout_s", "certain_s", "silent_s", "asleep_s"),
    [(0.05, 0.04, 0.04, 0.04), (0.02, 0.01, 0.01, 0.015), (10.0, 8.0, 0.08, 0.08)],
)
def test_a_short_time_out_shortens_what_is_not_seen(
    timeout_s: float, certain_s: float, silent_s: float, asleep_s: float
) -> None:
    short = replace(EACH, command_timeout_s=timeout_s)
    assert short.certain_s == about(certain_s)
    assert short.silent_s == about(silent_s)
    assert short.asleep_s == about(asleep_s)


@pytest.mark.parametrize(
    ("cycle_s", "timeout_s", "limit_s"),
    [
        (0.0, None, 0.08),
        (0.1, None, 0.25),
        (0.1, 0.15, 0.12),  # four fifths of the time-out: it comes more often
        (0.1, 0.1, 0.25),  # it comes less often, and is not waited for each time
        (math.inf, None, 0.08),
        (math.inf, 1.0, 0.8),
    ],
)
def test_how_long_the_report_of_the_bridge_may_be_missing(
    cycle_s: float, timeout_s: float | None, limit_s: float
) -> None:
    assert replace(EACH, command_timeout_s=timeout_s).unreported_s(cycle_s) == about(limit_s)


@pytest.mark.parametrize(
    ("timeout_s", "cycle_s", "limit_s"),
    [
        (None, 0.0, 0.08),
        (1.0, 0.0, 0.8),
        (1.0, 0.02, 0.8),  # two readings
        (1.0, 0.03, 0.08),
        (1.0, math.inf, 0.08),
        (0.05, 0.0, 0.04),
    ],
)
def test_how_late_a_command_may_be_without_hiding_a_stop(
    timeout_s: float | None, cycle_s: float, limit_s: float
) -> None:
    assert replace(EACH, command_timeout_s=timeout_s).hidden_s(cycle_s) == about(limit_s)


@pytest.mark.parametrize(
    ("start_s", "stop_s", "ticks", "on_s", "coming_s"),
    [
        (None, 0.5, 1, 0.3, 0.3),
        (0.1, 0.5, 1, 0.1, 0.25),  # half of a stop at least
        (0.6, 0.5, 1, 0.6, 0.48),  # two readings of the stop are left
        (0.6, 2.0, 1, 0.6, 1.0),
        (0.6, 0.5, 20, 0.6, 0.4),
        (0.6, 0.5, 100, 3.0, 1.0),
    ],
)
def test_a_stop_counts_once_the_drive_cannot_come_on_any_more(
    start_s: float | None, stop_s: float, ticks: int, on_s: float, coming_s: float
) -> None:
    timing = Timing(0.01, 0.05, ticks, start_s, stop_s)
    assert timing.switched_on_s == about(on_s)
    assert timing.coming_s == about(coming_s)
    assert timing.coming_s <= timing.switched_off_s


@pytest.mark.parametrize(
    ("stop_s", "report_s", "limit_s"),
    [(0.5, 0.0, 1.0), (0.5, 0.4, 1.0), (0.9, 0.4, 1.3), (5.0, math.inf, 5.0)],
)
def test_a_drive_has_its_stop_and_a_report_of_it_before_it_counts_as_disobedient(
    stop_s: float, report_s: float, limit_s: float
) -> None:
    assert replace(EACH, stop_s=stop_s).obeyed_s(report_s) == about(limit_s)


def test_the_table_of_limits_is_current() -> None:
    page = (CHECKOUT / "docs" / "proof" / "obedience.md").read_text(encoding="utf-8")
    assert page == with_table(page), "run `make docs`"
