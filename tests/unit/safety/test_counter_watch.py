"""The watch over the half-cycle counter: drives that start anew, old frames, and honest drives."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.runtime.timebase import HalfCycles
from adaptdrive.safety.frames import CounterWatch
from adaptdrive.safety.trips import Trip, TripKind
from tests.support import text_of

TICK_S = 2.0**-7
"""A half cycle whose multiples are exact."""

WIDTHS = st.integers(2, 24)
LONGEST_LOSS = 64
Frame = tuple[float, int]
"""Arrival of a frame in half cycles, and its count."""


def in_step(first: int, count: int, frames: int) -> list[Frame]:
    """Frames of a drive that counts its half cycles."""
    return [(first + n, count + n) for n in range(frames)]


def add(watch: CounterWatch, modulus: int, frame: Frame, tick_s: float = TICK_S) -> bool:
    return watch.add(frame[1] % modulus, frame[0] * tick_s, tick_s)


def begun(modulus: int, half_cycle: int) -> CounterWatch:
    """A watch that has seen three frames, the last of them in this half cycle."""
    watch = CounterWatch(modulus, TICK_S)
    for frame in in_step(half_cycle - 2, half_cycle - 2, 3):
        add(watch, modulus, frame)
    return watch


@st.composite
def honest_frames(draw: st.DrawFn, last: int) -> list[Frame]:
    """Frames after one: lost, late by up to 2.5 half cycles, off line, delayed or repeated late."""
    steps = draw(st.lists(st.integers(1, LONGEST_LOSS), min_size=1, max_size=150))
    counts = [last + sum(steps[: number + 1]) for number in range(len(steps))]
    kind = draw(
        st.sampled_from(["late", "off line", "in a queue", "newest of a queue", "repeated"])
    )
    if kind == "late":
        return [(count + draw(st.floats(0.0, 2.5)), count) for count in counts]
    if kind == "off line":
        pace = draw(st.floats(0.96, 1.04))
        return [(last + (count - last) * pace, count) for count in counts]
    if kind == "repeated":
        back = draw(st.integers(1, 30))
        pairs = [[(n, n), (n + 0.5, n - back)] for n in range(last + 1, last + 300)]
        return [frame for pair in pairs for frame in pair]
    stalled = steps[0]
    waited = [(last + stalled + 0.5, last + n + 1) for n in range(stalled)]
    kept = waited if kind == "in a queue" else waited[-1:]
    return [*kept, *in_step(last + stalled + 1, last + stalled + 1, 20)]


@given(width=WIDTHS, last=st.integers(40, 1 << 24), data=st.data())
def test_no_disturbance_of_an_honest_drive_is_a_restart(
    width: int, last: int, data: st.DataObject
) -> None:
    watch = begun(1 << width, last)
    for frame in data.draw(honest_frames(last)):
        add(watch, 1 << width, frame)
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
    for frame in in_step(last + away, first, 4):
        add(watch, modulus, frame)
        assert chance or watch.may_have_restarted
    cause = watch.find_cause(commanded=True)
    assert chance or str(cause).startswith("drive restarted: its half-cycle counter began anew")


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
    for number, (at_tick, count) in enumerate(in_step(last + away + late, late, 12)):
        for back in old if number == at else ():
            add(watch, 65536, (at_tick - 0.25, last - back))
            assert watch.may_have_restarted is (number > 0)
        add(watch, 65536, (at_tick, count))
        assert watch.may_have_restarted
    assert watch.find_cause(commanded=True) is not None


QUEUE = [(4.75, 202), (8.5, 203)]
"""Frames of a queue that grows until the drive starts anew, whose frames do not wait."""

SCATTERED = [(5.0, 0), (5.5, 2), (8.0, 3), (10.5, 7)]
"""Counts in doubt that are off by more than jitter."""


def resets(count: int) -> list[Frame]:
    """A drive that starts anew again and again."""
    again = [(2 * number + n + 1, n) for number in range(count) for n in range(2)]
    return [*again, *in_step(2 * count + 1, 2, 4)]


@pytest.mark.parametrize(
    ("modulus", "last", "frames", "suspect", "found"),
    [
        (65536, 200, [*QUEUE, *in_step(9, 6, 6)], [0, 0] + [1] * 6, True),
        (65536, 41_200, SCATTERED, [1] * 4, False),
        (65536, 41_200, [*SCATTERED, *((4.5 + n, n) for n in range(8, 12))], [1] * 8, True),
        (256, 100, in_step(3, 200, 300), [0] * 300, False),  # from where it has jumped to
        (65536, 41_200, in_step(3, 5_000, 10), [0] * 10, False),  # it has not begun at 0
        (65536, 41_200, [(3, 9)], [1], False),  # six half cycles before time it may have
        (65536, 41_200, [(3, 10)], [0], False),
        (32, 31, [(4, 0)], [0], False),  # three half cycles behind time it is late
        (32, 31, [(5, 0)], [1], False),
        (128, 130, [(100, 223)], [0], False),  # 4 % of the line, and the jitter
        (128, 130, [(100, 222)], [1], False),
        *((256, 100, resets(count), [1] * (2 * count + 4), True) for count in (2, 5)),
    ],
)
def test_a_count_is_in_doubt_where_it_may_have_begun_anew(
    modulus: int, last: int, frames: list[Frame], suspect: list[int], *, found: bool
) -> None:
    watch, seen = begun(modulus, last), []
    for arrival, count in frames:
        add(watch, modulus, (last + arrival, count))
        seen.append(int(watch.may_have_restarted))
    assert seen == suspect
    assert (watch.find_cause(commanded=True) is not None) is found


def test_the_trip_names_both_counts() -> None:
    watch = begun(65536, 41_200)
    for frame in in_step(41_207, 3, 4):
        add(watch, 65536, frame)
    text = "drive restarted: its half-cycle counter began anew, 3 where 41207 was due"
    assert watch.find_cause(commanded=True) == Trip(TripKind.DRIVE_RESTARTED, text)


def test_time_is_that_of_the_measured_half_cycle() -> None:
    watch = CounterWatch(256, TICK_S)
    for half_cycle in range(0, 1000, 20):
        add(watch, 256, (half_cycle, half_cycle), 2.0 * TICK_S)
        assert not watch.may_have_restarted


def test_a_drive_that_is_commanded_off_may_start_anew() -> None:
    watch = begun(256, 100)
    for number, frame in enumerate(in_step(101, 0, 10)):
        add(watch, 256, frame)
        assert watch.find_cause(commanded=number >= 2) is None
        assert not watch.may_have_restarted


def test_a_count_that_stands_is_old_though_its_drive_may_start_anew() -> None:
    """With the bridge off, and although two of its frames arrive at once."""
    watch = begun(256, 3)
    for half_cycle in range(8, 120):
        assert add(watch, 256, (half_cycle // 2, 3))
        assert watch.find_cause(commanded=False) is None


@pytest.mark.parametrize(
    ("modulus", "frames", "old"),
    [
        (65536, [(20, 1001), (23, 1007), (24, 1002)], True),  # it is the newest
        (65536, [(20, 1001), (23, 1008), (24, 1002)], False),  # it has leapt
        (16, [(7, 1000)], True),
        (16, [(8, 1000)], False),  # half of its range may have passed: it may have come round
    ],
)
def test_a_count_behind_the_newest_is_old(modulus: int, frames: list[Frame], *, old: bool) -> None:
    watch = begun(modulus, 1000)
    assert [add(watch, modulus, (1000 + at, n)) for at, n in frames][-1] is old


def test_without_a_counter_nothing_is_in_doubt() -> None:
    watch = CounterWatch(None, TICK_S)
    for number in range(10):
        assert not watch.add(None, number * TICK_S, TICK_S)
        assert not watch.may_have_restarted


def standing_ticks(
    modulus: int | None, frames: Iterable[Frame], stale_ticks: int = 20
) -> list[float]:
    """For how long the count has stood, after each frame."""
    base, found = HalfCycles(modulus, TICK_S, stale_s=stale_ticks * TICK_S), []
    for arrival, count in frames:
        base.place(None if modulus is None else count % modulus, arrival * TICK_S, -1)
        found.append(base.rate.standing_s / TICK_S)
    return found


SWAPPED = [(n, 5000 + n + 1 - 2 * (n % 2)) for n in range(100)]
"""Frames in the wrong order."""

UP = [float(n) for n in range(1, 23)]


@pytest.mark.parametrize(
    ("modulus", "stale", "before", "then", "stands"),
    [
        *((modulus, 0, [], in_step(100, 3, 300), [0.0] * 300) for modulus in (None, 4, 16, 65536)),
        (256, 0, [(0, 0)], [(1, 0)], [1.0]),
        (256, 0, [(0, 0)], [(1, 2), (2, 1)], [0.0, 1.0]),  # in the wrong order
        (256, 0, [(0, 0)], [(1, 4), (2, 3)], [0.0, 1.0]),
        (256, 0, [(0, 0)], [(1, 5), (2, 3)], [0.0, 0.0]),  # 5 has leapt, and is no newer frame
        (256, 0, [(0, 0)], [(10, 10), (11, 9)], [0.0, 1.0]),  # nine frames were lost
        (256, 0, [(0, 0)], [(1, -63)], [1.0]),
        (256, 0, [(0, 0)], [(1, -64)], [0.0]),  # it counts from elsewhere
        (4, 0, [(0, 0)], [(1, 1), (2, 0)], [0.0, 0.0]),  # of two bits: ahead or repeated
        (4, 0, [(0, 0)], [(1, 1), (2, 1)], [0.0, 1.0]),
        (256, 0, in_step(0, 100, 3), in_step(3, 82, 12), [*UP[:8], *[0.0] * 4]),
        (256, 20, in_step(0, 100, 3), in_step(3, 42, 40), [*UP, *[0.0] * 18]),  # for longest age
        (65536, 40, [*in_step(0, 0, 100), *in_step(100, 1100, 10)],
         [(110 + n, 1109) for n in range(5)], UP[:5]),  # it leapt ahead, and is repeated there
        (256, 0, in_step(0, 0, 7), [(7, 0)], [1.0]),  # of the wrong order, or of a restart
        (256, 0, in_step(0, 0, 8), [(8, 0)], [0.0]),
        (65536, 20, in_step(0, 1000, 100), [*in_step(100, 0, 20), (120, 18)], [*[0.0] * 20, 1.0]),
        (65536, 20, in_step(0, 1000, 100), [*in_step(100, 0, 20), (120, 13)], [*[0.0] * 20, 1.0]),
        (65536, 20, in_step(0, 0, 5000), in_step(5001, 9, 3), UP[1:4]),  # it cannot begin at 9
        *((65536, 20, in_step(0, 0, 5000), in_step(5000 + n, first, 200), [0.0] * 200)
          for n, first in [(3, 0), (1, 3), (1, 5), (40, 39)]),  # a restart
        (65536, 20, SWAPPED, in_step(100, 0, 100), [0.0] * 100),
    ],
)  # fmt: skip
def test_a_count_stands_while_it_is_not_ahead_of_the_newest(
    modulus: int | None, stale: int, before: list[Frame], then: list[Frame], stands: list[float]
) -> None:
    assert standing_ticks(modulus, [*before, *then], stale)[len(before) :] == stands


@pytest.mark.parametrize("count", [0, 2, 30_000, 59_990])
def test_one_count_that_is_wrong_lets_no_drive_stand_for_long(count: int) -> None:
    strange = [*in_step(0, 59_000, 1000), (1000, count), *in_step(1001, 60_001, 200)]
    assert max(standing_ticks(65536, strange)) <= 1.0


@pytest.mark.parametrize("stands", [1, 2, 6, 7, 29])
@pytest.mark.parametrize("first", [0, 250])
def test_a_count_that_stands_while_its_message_is_lost_is_no_restart(
    first: int, stands: int
) -> None:
    """The clock comes in another message, and goes on."""
    last = 256 + first
    watch = begun(256, last)
    for half_cycle in range(last + 1, last + 144):
        add(watch, 256, (half_cycle, last if half_cycle <= last + stands else half_cycle))
        assert watch.find_cause(commanded=True) is None
    assert not watch.may_have_restarted


@pytest.mark.parametrize(
    ("modulus", "first", "held", "found"),
    [(8, 10, 2, ""), (16, 10, 4, ""), (256, 10, 64, ""), (256, 0, 16, "drive restarted"),
     (256, 3, 16, "drive restarted"), (256, 254, 16, "drive restarted")],
)  # fmt: skip
def test_counts_that_are_repeated_in_turn_stand_or_are_those_of_a_restart(
    modulus: int, first: int, held: int, found: str
) -> None:
    stale = held + 4 if found else held
    base = HalfCycles(modulus, TICK_S, stale_s=stale * TICK_S)
    verdicts = []
    for arrival, count in [
        *in_step(0, first - 100 + held, 100),
        *((100 + n, first + n % held) for n in range(held + 5)),
    ]:
        base.place(count % modulus, arrival * TICK_S, -1)
        if base.rate.standing_s > stale * TICK_S:
            verdicts.append("stands")
        verdicts += filter(None, [text_of(base.counts.find_cause(commanded=True))])
    assert verdicts[0].startswith(found or ("stands", "drive restarted"))
