"""The watch over the half-cycle counter, against drives that start anew and drives that do not."""

from __future__ import annotations

from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.counter_watch import CounterWatch

TICK_S = 2.0**-7
"""A half cycle whose multiples are exact."""

WIDTHS = st.integers(2, 24)
LONGEST_LOSS = 64
JITTER_TICKS = 2.5


def see(watch: CounterWatch, half_cycle: int, modulus: int, late_ticks: float = 0.0) -> None:
    """Pass the frame of a half cycle, which began its count at 0, on to the watch."""
    watch.see(half_cycle % modulus, (half_cycle + late_ticks) * TICK_S, TICK_S)


def begun(modulus: int, half_cycle: int) -> CounterWatch:
    """A watch that has seen three frames, the last of them in this half cycle."""
    watch = CounterWatch(modulus, TICK_S)
    for number in range(half_cycle - 2, half_cycle + 1):
        see(watch, number, modulus)
    return watch


@given(
    width=WIDTHS,
    first=st.integers(0, 1 << 24),
    steps=st.lists(
        st.tuples(st.integers(1, LONGEST_LOSS), st.floats(0.0, JITTER_TICKS)), max_size=200
    ),
)
def test_no_loss_and_no_jitter_is_a_restart(
    width: int, first: int, steps: list[tuple[int, float]]
) -> None:
    watch = begun(1 << width, first + 2)
    ends = accumulate((step for step, _ in steps), initial=first + 2)
    for half_cycle, (_, late_ticks) in zip(list(ends)[1:], steps, strict=True):
        see(watch, half_cycle, 1 << width, late_ticks)
        assert not watch.in_doubt
        assert watch.find_cause(commanded=True) is None


@given(
    width=WIDTHS,
    first=st.integers(0, 1 << 24),
    pace=st.floats(0.96, 1.04),
    steps=st.lists(st.integers(1, LONGEST_LOSS), max_size=200),
)
def test_a_line_that_is_off_is_no_restart(
    width: int, first: int, pace: float, steps: list[int]
) -> None:
    watch = CounterWatch(1 << width, TICK_S)
    for half_cycle in accumulate(steps, initial=first):
        watch.see(half_cycle % (1 << width), half_cycle * pace * TICK_S, TICK_S)
        assert watch.find_cause(commanded=True) is None


@given(
    width=WIDTHS,
    last=st.integers(2, 1 << 24),
    stalled=st.integers(1, LONGEST_LOSS),
    kept=st.booleans(),
)
def test_frames_that_waited_and_come_at_once_are_no_restart(
    width: int, last: int, stalled: int, kept: bool
) -> None:
    watch = begun(1 << width, last)
    waited = range(last + 1, last + stalled + 1)
    for half_cycle in (*waited,) if kept else (*waited[-1:],):
        see(watch, half_cycle, 1 << width, last + stalled - half_cycle + 0.5)
        assert watch.find_cause(commanded=True) is None
    for half_cycle in range(last + stalled + 1, last + stalled + 20):
        see(watch, half_cycle, 1 << width)
        assert watch.find_cause(commanded=True) is None
    assert not watch.in_doubt


@given(width=WIDTHS, last=st.integers(40, 1 << 24), back=st.integers(1, 30))
def test_a_gateway_that_repeats_each_frame_late_is_no_restart(
    width: int, last: int, back: int
) -> None:
    watch = begun(1 << width, last)
    for half_cycle in range(last + 1, last + 300):
        see(watch, half_cycle, 1 << width)
        assert watch.find_cause(commanded=True) is None
        see(watch, half_cycle - back, 1 << width, back + 0.5)
        assert watch.find_cause(commanded=True) is None


@given(
    width=st.integers(5, 24),
    last=st.integers(2, 1 << 24),
    away=st.integers(1, LONGEST_LOSS),
    booted=st.floats(0.0, 1.0),
)
def test_a_drive_that_starts_anew_is_found_within_four_frames(
    width: int, last: int, away: int, booted: float
) -> None:
    """Unless its count is by chance what it would have been, or nearly."""
    modulus, watch = 1 << width, begun(1 << width, last)
    first = round(booted * away)
    off = (last + away - first) % modulus
    chance = min(off, modulus - off) <= 4 + 0.04 * (away + 4)
    for number in range(4):
        at_s = (last + away + number) * TICK_S
        watch.see((first + number) % modulus, at_s, TICK_S)
        assert chance or watch.in_doubt
    cause = watch.find_cause(commanded=True)
    assert chance or (cause or "").startswith("drive restarted: its half-cycle counter began anew")


@given(
    last=st.integers(300, 60_000),
    away=st.integers(1, 10),
    at=st.integers(0, 4),
    old=st.lists(st.integers(0, 4), min_size=1, max_size=3),
    late=st.integers(0, 5),
)
def test_old_frames_between_hide_no_new_start(
    last: int, away: int, at: int, old: list[int], late: int
) -> None:
    """A gateway sends frames from before the start anew once more, between those after it."""
    watch = begun(65536, last)
    for number in range(12):
        at_s = (last + away + late + number) * TICK_S
        if number == at:
            for back in old:
                watch.see(last - back, at_s - 0.25 * TICK_S, TICK_S)
                assert watch.in_doubt is (number > 0)
        watch.see(late + number, at_s, TICK_S)
        assert watch.in_doubt
    assert watch.find_cause(commanded=True) is not None


def test_frames_that_come_later_and_later_hide_no_new_start() -> None:
    """A queue grows until the drive starts anew, whose frames do not wait."""
    watch = begun(65536, 200)
    for half_cycle, late_ticks in ((202, 2.75), (203, 5.5)):
        see(watch, half_cycle, 65536, late_ticks)
    for number in range(6, 12):
        watch.see(number, (203 + number) * TICK_S, TICK_S)
        assert watch.in_doubt
    assert watch.find_cause(commanded=True) is not None


def test_counts_in_doubt_that_are_off_by_more_than_jitter_are_no_restart_yet() -> None:
    watch = begun(65536, 41_200)
    for count, ticks in ((0, 5.0), (2, 5.5), (3, 8.0), (7, 10.5)):
        watch.see(count, (41_200 + ticks) * TICK_S, TICK_S)
        assert watch.in_doubt
        assert watch.find_cause(commanded=True) is None
    for count in range(8, 12):
        watch.see(count, (41_204.5 + count) * TICK_S, TICK_S)
    assert watch.find_cause(commanded=True) is not None


@pytest.mark.parametrize("stands", range(1, 30))
@pytest.mark.parametrize("first", [0, 100, 240, 250, 255])
def test_a_count_that_stands_while_its_message_is_lost_is_no_restart(
    first: int, stands: int
) -> None:
    """The clock comes in another message, and goes on."""
    watch = begun(256, 256 + first)
    for half_cycle in range(257 + first, 400 + first):
        heard = 256 + first if half_cycle <= 256 + first + stands else half_cycle
        watch.see(heard % 256, half_cycle * TICK_S, TICK_S)
        assert watch.find_cause(commanded=True) is None
    assert not watch.in_doubt


def test_a_counter_that_has_jumped_is_followed_from_there() -> None:
    """Its next wrap is no new start."""
    watch = begun(256, 100)
    for number in range(300):
        watch.see((200 + number) % 256, (103 + number) * TICK_S, TICK_S)
        assert not watch.in_doubt


@pytest.mark.parametrize(("passed", "doubted"), [(4, False), (5, True)])
def test_a_count_three_half_cycles_behind_time_is_late(passed: int, doubted: bool) -> None:
    watch = begun(32, 31)
    watch.see(0, (31 + passed) * TICK_S, TICK_S)
    assert watch.in_doubt is doubted


def test_time_is_that_of_the_measured_half_cycle() -> None:
    watch = CounterWatch(256, TICK_S)
    for half_cycle in range(0, 1000, 20):
        watch.see(half_cycle % 256, half_cycle * 2.0 * TICK_S, 2.0 * TICK_S)
        assert not watch.in_doubt


def test_the_trip_names_both_counts() -> None:
    watch = begun(65536, 41_200)
    for number in range(3, 7):
        watch.see(number, (41_204 + number) * TICK_S, TICK_S)
    assert watch.find_cause(commanded=True) == (
        "drive restarted: its half-cycle counter began anew, 3 where 41207 was due"
    )


def test_a_count_that_may_not_have_begun_at_0_is_no_restart() -> None:
    watch = begun(65536, 41_200)
    for number in range(10):
        watch.see(5_000 + number, (41_203 + number) * TICK_S, TICK_S)
        assert not watch.in_doubt


@pytest.mark.parametrize(("count", "doubted"), [(9, True), (10, False)])
def test_a_count_six_half_cycles_before_time_may_have_begun_at_0(
    count: int, *, doubted: bool
) -> None:
    watch = begun(65536, 41_200)
    watch.see(count, 41_203 * TICK_S, TICK_S)
    assert watch.in_doubt is doubted


@pytest.mark.parametrize("resets", [2, 3, 5])
def test_a_drive_that_starts_anew_again_and_again_is_in_doubt_until_its_trip(resets: int) -> None:
    watch, half_cycle = begun(256, 100), 100
    for _ in range(resets):
        for number in range(2):
            half_cycle += 1
            watch.see(number, half_cycle * TICK_S, TICK_S)
            assert watch.in_doubt
    for number in range(2, 6):
        watch.see(number, (half_cycle + number - 1) * TICK_S, TICK_S)
    assert watch.find_cause(commanded=True) is not None


def test_a_drive_that_is_commanded_off_may_start_anew() -> None:
    watch = begun(256, 100)
    for number in range(2):
        watch.see(number, (101 + number) * TICK_S, TICK_S)
        assert watch.find_cause(commanded=False) is None
        assert not watch.in_doubt
    for number in range(2, 10):
        watch.see(number, (101 + number) * TICK_S, TICK_S)
        assert watch.find_cause(commanded=True) is None


def test_a_count_that_stands_is_old_though_its_drive_may_start_anew() -> None:
    """With the bridge off, and although two of its frames arrive at once."""
    watch = begun(256, 3)
    for ticks in range(4, 60):
        for _ in range(2):
            assert watch.see(3, ticks * TICK_S, TICK_S)
            assert watch.find_cause(commanded=False) is None


@pytest.mark.parametrize(("late", "doubted"), [(7, False), (8, True)])
def test_a_line_may_be_off_by_four_percent_beside_the_jitter(late: int, *, doubted: bool) -> None:
    watch = begun(128, 130)
    watch.see((230 - late) % 128, 230 * TICK_S, TICK_S)
    assert watch.in_doubt is doubted


@pytest.mark.parametrize(("ahead", "repeated"), [(6, True), (7, False)])
def test_a_count_that_is_too_late_to_keep_step_is_the_newest_unless_it_has_leapt(
    ahead: int, *, repeated: bool
) -> None:
    watch = begun(65536, 1000)
    assert not watch.see(1001, 1020 * TICK_S, TICK_S)
    assert not watch.see(1001 + ahead, 1023 * TICK_S, TICK_S)
    assert watch.see(1002, 1024 * TICK_S, TICK_S) is repeated


@pytest.mark.parametrize(("quiet", "old"), [(7, True), (8, False)])
def test_a_count_that_had_the_time_for_half_its_range_may_have_come_round(
    quiet: int, *, old: bool
) -> None:
    watch = begun(16, 3)
    assert watch.see(3, (3 + quiet) * TICK_S, TICK_S) is old


def test_without_a_counter_nothing_is_in_doubt() -> None:
    watch = CounterWatch(None, TICK_S)
    for number in range(10):
        watch.see(None, number * TICK_S, TICK_S)
        assert not watch.in_doubt
