"""Quantiles of times, and the share of refused frames, from what a test counts itself."""

from __future__ import annotations

import math
import statistics
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.devices.port import PortStatistics
from adaptdrive.runtime.accounts import WINDOW_S, RefusedShare
from adaptdrive.runtime.fast_loop import TimeWindow
from adaptdrive.runtime.timebase import BINS, Quantiles

TIMES = st.lists(st.floats(0.0, 1e6), min_size=1, max_size=400)


def quantiles(times_us: list[float]) -> Quantiles:
    window = TimeWindow()
    for time_us in times_us:
        window.add(time_us)
    return window.take()


@given(times_us=TIMES)
def test_quantiles_are_times_that_occurred_in_the_right_order(times_us: list[float]) -> None:
    found = quantiles(times_us)
    assert {found.p50, found.p99, found.max} <= set(times_us)
    assert found.max == max(times_us)
    share = sum(time_us <= found.p99 for time_us in times_us) / len(times_us)
    assert share >= 0.99 - 1.0 / len(times_us)
    assert statistics.median_low(times_us) <= found.p50 <= statistics.median_high(times_us)


def test_each_time_is_counted_once() -> None:
    window = TimeWindow()
    window.add(5.0)
    assert window.take().max == 5.0
    nothing = window.take()
    assert all(map(math.isnan, (nothing.p50, nothing.p99, nothing.max)))


def test_a_window_that_nobody_empties_keeps_the_latest_and_counts_all() -> None:
    window = TimeWindow()
    for time_us in [1e6] + [1.0] * 10_000:
        window.add(time_us)
    assert window.histogram[-1] == 1
    assert window.take().max == 1.0
    assert sum(window.histogram) == 10_001


@given(times_us=TIMES, looks=st.integers(0, 3))
def test_the_histogram_counts_by_powers_of_two_whoever_looks_at_the_quantiles(
    times_us: list[float], looks: int
) -> None:
    window = TimeWindow()
    for time_us in times_us:
        window.add(time_us)
    for _ in range(looks):
        window.take()
    edges = [0.0, *(2.0**power for power in range(BINS - 1)), np.inf]
    assert window.histogram == tuple(np.histogram(times_us, edges)[0])


def test_times_that_are_no_times_never_stop_a_tick() -> None:
    window = TimeWindow()
    for time_us in (-3.0, math.nan, math.inf, -math.inf):
        window.add(time_us)
    assert (window.histogram[0], window.histogram[-1], sum(window.histogram)) == (3, 1, 4)


def test_between_two_reports_4096_times_are_kept() -> None:
    for others, longest in ((4095, 50.0), (4096, 1.0)):
        assert quantiles([50.0] + [1.0] * others).max == longest


STEP_S = 0.1


class Counting:
    """A port whose counts grow by a fixed number in each step."""

    def __init__(self, limit: float = 0.0) -> None:
        self.share = RefusedShare("drive", limit)
        self.counts = asdict(PortStatistics())
        self.now_s = 0.0
        self.reported: list[str] = []

    def pass_time(self, seconds: float, **each_step: int) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            for name, number in each_step.items():
                self.counts[name] += number
            found = self.share.add(self.now_s, dict(self.counts))
            if found is not None:
                self.reported.append(found)


@pytest.mark.parametrize(
    ("each_step", "share"),
    [
        ({"received": 20, "wrong_checksum": 10}, "50%"),
        ({"received": 20, "wrong_length": 20}, "100%"),
        ({"received": 20, "counter_stuck": 4}, "20%"),
        ({"received": 40, "foreign": 20, "out_of_range": 10}, "50%"),
        ({"received": 5, "exceptions": 5}, "50%"),
        ({"received": 5, "timeouts": 5}, "50%"),
        ({"received": 5, "timeouts": 5, "wrong_checksum": 5}, "50%"),
    ],
)
def test_a_large_share_is_reported_with_its_reason(each_step: dict[str, int], share: str) -> None:
    port = Counting()
    port.pass_time(3.0 * WINDOW_S, **each_step)
    (text,) = port.reported
    assert f"drive: {share} of" in text
    assert list(each_step)[-1] in text
    assert port.share.cause is None


def test_a_share_at_its_limit_is_a_cause_until_it_falls() -> None:
    port = Counting(limit=0.5)
    port.pass_time(2.0 * WINDOW_S, received=20, wrong_checksum=9)
    assert port.share.cause is None
    port.pass_time(2.0 * WINDOW_S, received=20, wrong_checksum=11)
    assert port.share.cause is not None
    assert port.share.cause.text.startswith("refused frames: drive: 55% of")
    port.pass_time(2.0 * WINDOW_S, received=20)
    assert port.share.cause is None


@pytest.mark.parametrize(
    ("times", "course", "reports"),
    [
        (1, [(2.0, 24, 0, 0), (0.06, 24, 24, 0), (2.0, 24, 1, 0)], 0),  # a burst, a rare one
        (3, [(2.0, 24, 12, 0), (2.0, 24, 0, 0)], 3),  # again after a good window
        (10, [(1.0, 100, 11, 0), (1.0, 100, 8, 0)], 1),  # about the limit
        (1, [(3.0, 0, 0, 0), (3.0, 0, 0, 5)], 0),  # silence is no refusal
    ],
)
def test_a_share_that_lasts_is_reported_once_until_a_good_window(
    times: int, course: list[tuple[float, int, int, int]], reports: int
) -> None:
    port = Counting(limit=0.6)
    for windows, received, refused, silent in course * times:
        port.pass_time(
            windows * WINDOW_S, received=received, wrong_checksum=refused, timeouts=silent
        )
    assert len(port.reported) == reports
    assert port.share.cause is None


def test_the_last_of_seventeen_bins_begins_at_32768_us() -> None:
    window = TimeWindow()
    for time_us in (32_767.0, 32_768.0, 1e12):
        window.add(time_us)
    assert window.histogram == (0,) * 15 + (1, 2)
