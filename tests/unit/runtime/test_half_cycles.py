"""The time base, against drives whose half cycles the test counts itself."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.timebase import HalfCycles

TICK_S = 2.0**-7
"""A half cycle whose multiples are exact."""

START_S = 64.0
MODULI = st.sampled_from([16, 256, 65536])
Frame = tuple[float, int | None]
"""Arrival of a frame in half cycles, and its count."""


def placed(
    frames: Iterable[Frame], modulus: int | None = None, stride: int = 1, held: int = 0
) -> list[int]:
    """Ticks of frames, after the first of which so many stand-ins have run."""
    base, ticks, latest = HalfCycles(modulus, TICK_S, stride), [], -1
    for arrival, count in frames:
        wrapped = None if modulus is None or count is None else count % modulus
        ticks.append(base.place(wrapped, START_S + arrival * TICK_S, latest))
        latest = max(latest, ticks[-1], held)
    return ticks


def uncounted(arrivals: Iterable[float], stride: int = 1) -> list[int]:
    return placed([(arrival, None) for arrival in arrivals], None, stride)


@given(
    modulus=MODULI,
    first=st.integers(0, 65535),
    steps=st.lists(st.integers(1, 12), min_size=1, max_size=100),
)
def test_ticks_follow_the_drive_through_wraps_and_lost_frames(
    modulus: int, first: int, steps: list[int]
) -> None:
    passed = [sum(steps[:number]) for number in range(len(steps) + 1)]
    assert placed([(one, first + one) for one in passed], modulus) == passed


@given(
    modulus=MODULI,
    outage=st.integers(0, 70_000),
    before=st.integers(0, 65535),
    after=st.integers(0, 65535),
    held=st.booleans(),
)
def test_a_restarted_drive_is_followed_again_within_two_frames(
    modulus: int, outage: int, before: int, after: int, *, held: bool
) -> None:
    """Whatever its counter says, its frames soon make a tick each: never one before the latest."""
    base, latest, ticks = HalfCycles(modulus, TICK_S), -1, []
    for number in range(9):
        count, silent = (before + number, 0) if number < 3 else (after + number - 3, outage)
        latest += outage if held and number == 3 else 0
        ticks.append(base.place(count % modulus, START_S + (number + silent) * TICK_S, latest))
        latest = max(latest, ticks[-1])
    assert [b - a for a, b in pairwise(ticks[4:])] == [1] * 4
    assert latest - ticks[-1] <= 3


@pytest.mark.parametrize(
    ("modulus", "held", "frames", "ticks"),
    [
        (256, 1, [(0, 10), (1.6, 11), (2, 12)], [0, 1, 2]),  # a stand-in had its tick
        (256, 20, [(n, 10 + n) for n in range(22)], list(range(22))),  # they waited in a queue
        (65536, 0, [(0, 10), (1, 5000), (2, 5001)], [0, 1, 2]),  # it leaps ahead of time
        (256, 0, [(0, 10), (1, 14)], [0, 4]),  # it may be three half cycles ahead of time
        (256, 0, [(0, 10), (1, 15)], [0, 1]),
        (256, 0, [(0, 10), (1, 9)], [0, 1]),
        (None, 0, [(0, None), (0.5, None)], [0, 1]),  # it may be three quarters late
        (None, 0, [(0, None), (1.74, None)], [0, 1]),
        (None, 0, [(0, None), (1.75, None)], [0, 2]),
        (None, 0, [(0, None), (2.74, None)], [0, 2]),
    ],
)
def test_a_frame_belongs_to_the_half_cycle_that_its_count_or_time_tells(
    modulus: int | None, held: int, frames: list[Frame], ticks: list[int]
) -> None:
    assert placed(frames, modulus, held=held) == ticks


@given(
    late=st.lists(st.floats(0.0, 0.7), min_size=1, max_size=300),
    line=st.sampled_from([0.98, 0.995, 1.0, 1.005, 1.02]),
)
def test_each_frame_of_a_drive_with_jitter_is_a_half_cycle_of_its_own(
    late: list[float], line: float
) -> None:
    arrivals = sorted(number * line + one for number, one in enumerate(late))
    assert uncounted(arrivals) == list(range(len(late)))


@pytest.mark.parametrize("line", [0.94, 1.06])
def test_a_line_that_is_off_as_far_as_a_rate_may_be_has_a_tick_for_each_frame(line: float) -> None:
    assert uncounted(number * line for number in range(1000)) == list(range(1000))


@given(steps=st.lists(st.integers(1, 40), max_size=60))
def test_without_a_counter_time_counts_the_half_cycles(steps: list[int]) -> None:
    passed = [sum(steps[:number]) for number in range(len(steps) + 1)]
    assert uncounted(map(float, passed)) == passed


@given(st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=100))
def test_polls_are_whole_strides_apart_however_late_their_replies(delays: list[float]) -> None:
    arrivals = [12.0 * (number + delay) for number, delay in enumerate(delays)]
    assert uncounted(arrivals, stride=12) == [12 * number for number in range(len(delays))]


@pytest.mark.parametrize("apart", [0.0, 0.125, 0.3, 0.6])
@pytest.mark.parametrize("together", [2, 3, 4])
def test_frames_that_come_together_do_not_make_time_run_faster(together: int, apart: float) -> None:
    """A gateway, or a driver, that passes on several at once: only the last one is in time."""
    arrivals = [group * together + one * apart for group in range(500) for one in range(together)]
    assert uncounted(sorted(arrivals))[-1] == pytest.approx(arrivals[-1], abs=2.0)


@pytest.mark.parametrize("late", [0.7, 0.8, 0.95])
def test_replies_that_are_early_and_late_in_turn_do_not_make_time_run_faster(late: float) -> None:
    arrivals = [6.0 * (number + late * (number % 2)) for number in range(500)]
    ticks = uncounted(arrivals, stride=6)
    assert ticks[-1] == pytest.approx(arrivals[-1], abs=6.0)
    assert {tick % 6 for tick in ticks} == {0}


@pytest.mark.parametrize("after", [0.0, 0.2, 0.4])
def test_a_frame_that_is_repeated_now_and_then_shifts_no_later_one(after: float) -> None:
    repeats = {number * 10 + after for number in range(10, 100)}
    arrivals = sorted([*map(float, range(1000)), *repeats])
    found = dict(zip(arrivals, uncounted(arrivals), strict=True))
    assert all(found[arrival] == arrival for arrival in map(float, range(1000)))


def test_frames_that_come_late_once_or_were_lost_shift_no_later_one() -> None:
    for late in (0.5, 0.7, 1.0, 2.5, 30.0):
        arrivals = [max(100.0 + late, n) if n >= 100 else float(n) for n in range(300)]
        assert uncounted(arrivals)[-100:] == list(range(200, 300)), late
    kept = [number for number in range(3000) if number % 50 < 20 or number % 7 == 3]
    assert uncounted(number + 0.2 * (number % 2) for number in kept) == kept


def periods(
    lengths: Iterable[float], stride: int = 1, counts: Iterable[int] | None = None
) -> list[float]:
    """Half cycles that are measured, of frames some half cycles apart, in nominal ones."""
    base, latest, now_s, found = HalfCycles(65536, TICK_S, stride), -1, START_S, []
    for number, length in zip(counts or range(0, 10**6, stride), lengths, strict=False):
        latest = base.place(number, now_s, latest)
        now_s += length * TICK_S
        found.append(base.tick_period_s / TICK_S)
    return found


@pytest.mark.parametrize("factor", [0.981, 0.992, 1.0, 1.008, 1.019])
def test_the_half_cycle_is_measured_through_jitter(factor: float) -> None:
    jitter = [
        0.06 if number % 7 == 3 else -0.06 if number % 7 == 4 else 0.0 for number in range(2000)
    ]
    assert periods(factor + one for one in jitter)[-1] == pytest.approx(factor, rel=1e-3)


@pytest.mark.parametrize(("factor", "measured"), [(1.019, True), (1.021, False), (0.981, True)])
def test_a_half_cycle_is_measured_after_half_a_second_and_believed_within_two_percent(
    factor: float, *, measured: bool
) -> None:
    found = periods([factor] * 61)
    assert found[59] == 1.0
    assert found[60] == pytest.approx(factor if measured else 1.0, rel=1e-9)


@given(gaps=st.lists(st.floats(0.0, 12.0), min_size=1, max_size=300))
def test_the_measured_half_cycle_stays_near_the_nominal_one(gaps: list[float]) -> None:
    assert all(abs(found - 1.0) <= 0.02 for found in periods(gaps))


def test_the_half_cycle_is_that_of_the_last_1200_and_of_no_drive_before_a_restart() -> None:
    found = periods([1.01] * 1800 + [1.0] * 1801)
    assert [count for count, period in enumerate(found) if period == 1.0][60] == 1800 + 1200
    anew = periods([1.01] * 60 + [4000.0] + [0.99] * 61, counts=[*range(61), *range(61)])
    assert anew[-1] == pytest.approx(0.99, rel=1e-9)


def test_a_drive_that_sends_every_second_half_cycle_is_not_measured() -> None:
    assert set(periods([2.01] * 200, stride=2)) == {1.0}
