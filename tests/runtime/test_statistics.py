"""Quantiles of what came in since the last look, and counts of all that ever came in."""

from __future__ import annotations

import math
import statistics

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.reports import Quantiles
from adaptdrive.runtime.statistics import BINS, TimeWindow

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


def test_one_outlier_in_a_thousand_shows_in_the_maximum_only() -> None:
    found = quantiles([10.0] * 999 + [8000.0])
    assert (found.p50, found.p99, found.max) == (10.0, 10.0, 8000.0)


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


def test_the_last_of_seventeen_bins_begins_at_32768_us() -> None:
    window = TimeWindow()
    for time_us in (32_767.0, 32_768.0, 1e12):
        window.add(time_us)
    assert window.histogram == (0,) * 15 + (1, 2)


def test_between_two_reports_4096_times_are_kept() -> None:
    for others, longest in ((4095, 50.0), (4096, 1.0)):
        assert quantiles([50.0] + [1.0] * others).max == longest
