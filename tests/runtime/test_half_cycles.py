"""The time base, against drives whose half cycles the test counts itself."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.half_cycles import HalfCycles

TICK_S = 1.0 / 120.0
MODULI = st.sampled_from([16, 256, 65536])


def time_base(modulus: int | None = 256) -> HalfCycles:
    return HalfCycles(modulus, TICK_S)


@given(
    modulus=MODULI,
    first=st.integers(0, 65535),
    steps=st.lists(st.integers(1, 12), min_size=1, max_size=100),
)
def test_ticks_follow_the_drive_through_wraps_and_lost_frames(
    modulus: int, first: int, steps: list[int]
) -> None:
    base, half_cycle, latest = time_base(modulus), first, -1
    start = base.place(first % modulus, first * TICK_S, latest)
    for step in steps:
        half_cycle += step
        tick = base.place(half_cycle % modulus, half_cycle * TICK_S, latest)
        assert tick - start == half_cycle - first
        latest = max(latest, tick)


@given(
    modulus=MODULI,
    outage_ticks=st.integers(0, 70_000),
    before=st.integers(0, 65535),
    after=st.integers(0, 65535),
    held=st.booleans(),
)
def test_a_restarted_drive_is_followed_again_within_two_frames(
    modulus: int, outage_ticks: int, before: int, after: int, held: bool
) -> None:
    """Whatever its counter says, its frames soon make a tick each: never one before the latest."""
    base, time_s, latest = time_base(modulus), 50.0, -1
    for half_cycle in range(before, before + 3):
        time_s += TICK_S
        latest = base.place(half_cycle % modulus, time_s, latest)
    time_s += outage_ticks * TICK_S
    latest += outage_ticks if held else 0
    ticks = []
    for half_cycle in range(after, after + 6):
        time_s += TICK_S
        ticks.append(base.place(half_cycle % modulus, time_s, latest))
        latest = max(latest, ticks[-1])
    settled = ticks[1:]
    assert [b - a for a, b in pairwise(settled)] == [1] * 4
    assert latest - ticks[-1] <= 3


def test_a_frame_that_a_stand_in_replaced_keeps_its_tick() -> None:
    base = time_base()
    first = base.place(10, 1.0, -1)
    stand_in = first + 1
    assert base.place(11, 1.0 + 1.6 * TICK_S, stand_in) == stand_in
    assert base.place(12, 1.0 + 2.0 * TICK_S, stand_in) == stand_in + 1


def test_frames_that_waited_in_a_queue_keep_their_ticks() -> None:
    """The daemon slept for 20 half cycles and ran one tick; then it reads what had arrived."""
    base = time_base()
    first = base.place(10, 1.0, -1)
    latest = first + 20
    ticks = [base.place(10 + step, 1.0 + step * TICK_S, latest) for step in range(1, 21)]
    assert ticks == [first + step for step in range(1, 21)]
    assert base.place(31, 1.0 + 21 * TICK_S, latest) == latest + 1


def test_a_counter_that_leaps_ahead_of_time_is_anchored_anew() -> None:
    base = time_base(65536)
    first = base.place(10, 1.0, -1)
    assert base.place(5000, 1.0 + TICK_S, first) == first + 1
    assert base.place(5001, 1.0 + 2 * TICK_S, first + 1) == first + 2


@given(steps=st.lists(st.integers(1, 40), max_size=60))
def test_without_a_counter_time_counts_the_half_cycles(steps: list[int]) -> None:
    base, time_s, latest = time_base(None), 7.0, -1
    latest = base.place(None, time_s, latest)
    for step in steps:
        time_s += step * TICK_S
        tick = base.place(None, time_s, latest)
        assert tick == latest + step
        latest = tick


@pytest.mark.parametrize("line_Hz", [59.5, 59.9, 60.0, 60.1, 60.5])
def test_the_half_cycle_is_measured(line_Hz: float) -> None:
    base, true_s, latest = time_base(65536), 0.5 / line_Hz, -1
    for half_cycle in range(2000):
        jitter_s = 0.0005 if half_cycle % 7 == 3 else 0.0
        latest = base.place(half_cycle, half_cycle * true_s + jitter_s, latest)
    assert base.tick_period_s == pytest.approx(true_s, rel=1e-3)


@given(gaps_s=st.lists(st.floats(0.0, 0.1), min_size=1, max_size=300))
def test_the_measured_half_cycle_stays_near_the_nominal_one(gaps_s: list[float]) -> None:
    base, time_s, latest = time_base(65536), 0.0, -1
    for half_cycle, gap_s in enumerate(gaps_s):
        time_s += gap_s
        latest = max(latest, base.place(half_cycle, time_s, latest))
    assert abs(base.tick_period_s / TICK_S - 1.0) <= 0.02


EXACT_S = 2.0**-7
"""A half cycle whose multiples are exact."""


@pytest.mark.parametrize(("leap", "tick"), [(4, 4), (5, 1), (-1, 1)])
def test_a_counter_three_half_cycles_ahead_of_time_is_believed(leap: int, tick: int) -> None:
    base = HalfCycles(256, EXACT_S)
    first = base.place(10, 1.0, -1)
    assert base.place((10 + leap) % 256, 1.0 + EXACT_S, first) == first + tick


@pytest.mark.parametrize(("late", "tick"), [(0.5, 1), (1.74, 1), (1.75, 2), (2.74, 2)])
def test_without_a_counter_a_frame_may_be_three_quarters_late(late: float, tick: int) -> None:
    base = HalfCycles(None, EXACT_S)
    first = base.place(None, 1.0, -1)
    assert base.place(None, 1.0 + late * EXACT_S, first) == first + tick


def ticks_of(arrivals: list[float], stride: int = 1) -> list[int]:
    """Ticks of frames without a counter that come at these times, in half cycles."""
    base, ticks = HalfCycles(None, EXACT_S, stride), [-1]
    for arrival in arrivals:
        ticks.append(base.place(None, 64.0 + arrival * EXACT_S, max(ticks)))
    return ticks[1:]


@pytest.mark.parametrize("apart", [0.0, 0.125, 0.3, 0.6])
@pytest.mark.parametrize("together", [2, 3, 4])
def test_frames_that_come_together_do_not_make_time_run_faster(together: int, apart: float) -> None:
    """A gateway, or a driver, that passes on several at once: only the last one is in time."""
    arrivals = [group * together + one * apart for group in range(500) for one in range(together)]
    passed = ticks_of(sorted(arrivals))[-1]
    assert passed == pytest.approx(arrivals[-1], abs=2.0)


@pytest.mark.parametrize("late", [0.7, 0.8, 0.95])
def test_replies_that_are_early_and_late_in_turn_do_not_make_time_run_faster(late: float) -> None:
    arrivals = [6.0 * (number + late * (number % 2)) for number in range(500)]
    ticks = ticks_of(arrivals, stride=6)
    assert ticks[-1] == pytest.approx(arrivals[-1], abs=6.0)
    assert {tick % 6 for tick in ticks} == {0}


@given(
    late=st.lists(st.floats(0.0, 0.7), min_size=1, max_size=300),
    line=st.sampled_from([0.98, 0.995, 1.0, 1.005, 1.02]),
)
def test_each_frame_of_a_drive_with_jitter_is_a_half_cycle_of_its_own(
    late: list[float], line: float
) -> None:
    arrivals = sorted(number * line + one for number, one in enumerate(late))
    assert ticks_of(arrivals) == list(range(len(late)))


@pytest.mark.parametrize("line", [0.94, 1.06])
def test_a_line_that_is_off_as_far_as_a_rate_may_be_has_a_tick_for_each_frame(line: float) -> None:
    assert ticks_of([number * line for number in range(1000)]) == list(range(1000))


@pytest.mark.parametrize("after", [0.0, 0.2, 0.4])
def test_a_frame_that_is_repeated_now_and_then_shifts_no_later_one(after: float) -> None:
    repeats = {number * 10 + after for number in range(10, 100)}
    arrivals = sorted([*map(float, range(1000)), *repeats])
    found = dict(zip(arrivals, ticks_of(arrivals), strict=True))
    assert all(found[arrival] == arrival for arrival in map(float, range(1000)))


def test_a_frame_that_comes_late_once_shifts_no_later_one() -> None:
    for late in (0.5, 0.7, 1.0, 2.5, 30.0):
        arrivals = [float(number) for number in range(100)]
        arrivals += [max(100.0 + late, number) for number in range(100, 300)]
        assert ticks_of(arrivals)[-100:] == list(range(200, 300)), late


def test_frames_that_were_lost_are_made_up_for() -> None:
    kept = [number for number in range(3000) if number % 50 < 20 or number % 7 == 3]
    assert ticks_of([number + 0.2 * (number % 2) for number in kept]) == kept


@pytest.mark.parametrize(("factor", "measured"), [(1.019, True), (1.021, False), (0.981, True)])
def test_a_half_cycle_is_measured_after_half_a_second_and_believed_within_two_percent(
    factor: float, *, measured: bool
) -> None:
    base, latest = HalfCycles(65536, EXACT_S), -1
    for count in range(60):
        latest = base.place(count, 64.0 + count * factor * EXACT_S, latest)
    assert base.tick_period_s == EXACT_S
    base.place(60, 64.0 + 60 * factor * EXACT_S, latest)
    expected_s = factor * EXACT_S if measured else EXACT_S
    assert base.tick_period_s == pytest.approx(expected_s, rel=1e-9)


def test_the_half_cycle_is_that_of_the_last_1200() -> None:
    base, latest, time_s, found = HalfCycles(65536, EXACT_S), -1, 64.0, []
    for count in range(3601):
        time_s += EXACT_S * (1.01 if count <= 1800 else 1.0)
        latest = base.place(count, time_s, latest)
        found.append(base.tick_period_s)
    settled = [count for count, period_s in enumerate(found) if period_s == EXACT_S]
    assert settled[60] == 1800 + 1200


def test_a_restarted_drive_is_measured_anew() -> None:
    base, latest = HalfCycles(65536, EXACT_S), -1
    for count in range(61):
        latest = base.place(count, 64.0 + count * 1.01 * EXACT_S, latest)
    for count in range(61):
        latest = base.place(count, 96.0 + count * 0.99 * EXACT_S, latest)
    assert base.tick_period_s == pytest.approx(0.99 * EXACT_S, rel=1e-9)


def test_a_drive_that_sends_every_second_half_cycle_is_not_measured() -> None:
    base, latest = HalfCycles(None, EXACT_S, 2), -1
    for number in range(200):
        latest = base.place(None, 64.0 + number * 2.01 * EXACT_S, latest)
    assert base.tick_period_s == EXACT_S


@pytest.mark.parametrize("stands_in", [False, True])
def test_only_frames_after_a_stand_in_come_too_seldom(*, stands_in: bool) -> None:
    base, latest = HalfCycles(256, EXACT_S), -1
    for number in range(200):
        latest = base.place(2 * number % 256, 64.0 + 2 * number * EXACT_S, latest + stands_in)
    assert (base.rate.cause is None) is not stands_in


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("kept", [(0, 1, 2), (0, 1, 2, 3, 4), (0, 4)])
def test_lost_frames_of_a_drive_without_a_counter_are_no_wrong_rate(
    stride: int, kept: tuple[int, ...]
) -> None:
    """Of each eight some are lost; the daemon has run no tick in their place."""
    base, latest = HalfCycles(None, EXACT_S, stride), -1
    for number in range(8000):
        if number % 8 in kept:
            latest = base.place(None, 64.0 + number * stride * EXACT_S, latest)
    assert base.rate.judged
    assert base.rate.cause is None


def standing_ticks(
    modulus: int | None, *frames: tuple[int, int], stale_ticks: int = 0
) -> list[float]:
    """For how long the count has stood, after each frame of a tick and a count."""
    half_s = 1.0 / 128.0  # an exact number
    base, found = HalfCycles(modulus, half_s, stale_s=stale_ticks * half_s), []
    for tick, count in frames:
        base.place(None if modulus is None else count % modulus, tick * half_s, -1)
        found.append(base.rate.standing_s / half_s)
    return found


def verdict(modulus: int, *frames: tuple[int, int], stale_ticks: int) -> str:
    """The first reason to trip a drive whose bridge is commanded on."""
    base = HalfCycles(modulus, EXACT_S, stale_s=stale_ticks * EXACT_S)
    for tick, count in frames:
        base.place(count % modulus, tick * EXACT_S, -1)
        if base.rate.standing_s > stale_ticks * EXACT_S:
            return "stands"
        if (cause := base.counts.find_cause(commanded=True)) is not None:
            return cause.partition(":")[0]
    return ""


def in_step(first: int, count: int, frames: int) -> list[tuple[int, int]]:
    """Frames of a drive that counts its half cycles."""
    return [(first + n, count + n) for n in range(frames)]


@pytest.mark.parametrize("modulus", [None, 4, 16, 256, 65536])
def test_the_count_of_a_drive_that_runs_stands_never(modulus: int | None) -> None:
    assert set(standing_ticks(modulus, *in_step(100, 3, 300))) == {0.0}


@pytest.mark.parametrize(
    ("then", "stands"),
    [
        ([(1, 0)], True),
        ([(1, 2), (2, 1)], True),  # two frames in the wrong order
        ([(1, 4), (2, 3)], True),
        ([(1, 5), (2, 3)], False),  # 5 has leapt, and is no newer frame
        ([(10, 10), (11, 9)], True),  # nine frames were lost
        ([(1, -63)], True),
        ([(1, -64)], False),  # a drive that counts from elsewhere
    ],
)
def test_a_count_behind_the_newest_stands(then: list[tuple[int, int]], stands: bool) -> None:
    assert (standing_ticks(256, (0, 0), *then)[-1] > 0.0) is stands


def test_a_count_of_two_bits_is_ahead_or_repeated() -> None:
    assert standing_ticks(4, (0, 0), (1, 1), (2, 0)) == [0.0, 0.0, 0.0]
    assert standing_ticks(4, (0, 0), (1, 1), (2, 1)) == [0.0, 0.0, 1.0]


def test_a_drive_that_counts_anew_moves_from_its_ninth_frame_on() -> None:
    stood = standing_ticks(256, *in_step(0, 100, 3), *in_step(3, 82, 12))
    assert stood[3:] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("modulus", "held"), [(8, 2), (16, 2), (16, 4), (64, 16), (256, 64)])
def test_counts_that_are_repeated_in_turn_stand_or_are_those_of_a_restart(
    modulus: int, held: int
) -> None:
    in_turn = [(held + n, 10 + n % held) for n in range(held + 5)]
    found = verdict(modulus, *in_step(0, 10, held), *in_turn, stale_ticks=held)
    assert found in {"stands", "drive restarted"}


@pytest.mark.parametrize("first", [0, 1, 3, 248, 254])
def test_counts_that_are_repeated_in_turn_about_zero_are_those_of_a_restart(first: int) -> None:
    in_turn = [(100 + n, first + n % 16) for n in range(20)]
    before = in_step(0, first - 84, 100)
    assert verdict(256, *before, *in_turn, stale_ticks=20) == "drive restarted"


def test_a_drive_that_starts_anew_behind_frames_in_the_wrong_order_repeats_nothing() -> None:
    swapped = [(n, 5000 + n + 1 - 2 * (n % 2)) for n in range(100)]
    anew = standing_ticks(65536, *swapped, *in_step(100, 0, 100), stale_ticks=20)[100:]
    assert set(anew) == {0.0}


def test_a_count_that_leapt_back_moves_once_it_has_kept_step_for_the_longest_age() -> None:
    stood = standing_ticks(256, *in_step(0, 100, 3), *in_step(3, 42, 40), stale_ticks=20)
    assert [ticks for ticks in stood[3:] if ticks] == [float(n) for n in range(1, 23)]


def test_a_count_that_leapt_ahead_stands_where_it_is_repeated() -> None:
    leapt = [*in_step(0, 0, 100), *in_step(100, 1100, 10)]
    again = [(110 + n, 1109) for n in range(5)]
    stood = standing_ticks(65536, *leapt, *again, stale_ticks=40)
    assert stood[100:] == [*[0.0] * 10, 1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.parametrize(("before", "stands"), [(7, True), (8, False)])
def test_a_count_of_0_is_that_of_a_restart_where_no_wrong_order_explains_it(
    before: int, *, stands: bool
) -> None:
    assert (standing_ticks(256, *in_step(0, 0, before), (before, 0))[-1] > 0.0) is stands


@pytest.mark.parametrize("behind", [1, 6])
def test_a_frame_in_the_wrong_order_stands_after_a_restart_too(behind: int) -> None:
    anew = [*in_step(0, 1000, 100), *in_step(100, 0, 20), (120, 19 - behind)]
    assert standing_ticks(65536, *anew, stale_ticks=20)[-1] == 1.0


def test_a_count_that_cannot_have_begun_at_0_is_that_of_no_restart() -> None:
    anew = in_step(5001, 9, 3)  # two half cycles after the last frame
    assert standing_ticks(65536, *in_step(0, 0, 5000), *anew, stale_ticks=20)[-1] > 0.0


@pytest.mark.parametrize(("frames", "begin"), [(3, 0), (1, 3), (1, 5), (40, 39)])
def test_a_drive_that_has_started_anew_repeats_nothing(frames: int, begin: int) -> None:
    anew = in_step(5000 + frames, begin, 200)
    assert set(standing_ticks(65536, *in_step(0, 0, 5000), *anew, stale_ticks=20)) == {0.0}


@pytest.mark.parametrize("count", [0, 2, 30_000, 59_990])
def test_one_count_that_is_wrong_lets_no_drive_stand_for_long(count: int) -> None:
    strange = [*in_step(0, 59_000, 1000), (1000, count), *in_step(1001, 60_001, 200)]
    assert max(standing_ticks(65536, *strange, stale_ticks=20)) <= 1.0
