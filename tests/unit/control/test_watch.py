"""The watches over the loop and for limit cycles: each rule, and what must not set it off."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.settings import SupervisionLimits
from adaptdrive.control.supervision.monitor import (
    AT_LIMIT,
    SWINGS,
    TIME_CONSTANTS,
    CycleMonitor,
    Fallback,
    LoopMonitor,
)
from adaptdrive.control.thresholds import WINDOW

JACKET = SupervisionLimits(
    warm_up_periods=0,
    ratio_min=0.2,
    ratio_max=6.0,
    saturated_periods=240,
    error_limit=0.4,
    swing_min=0.05,
    response_periods=120,
    response_distance=0.05,
)
LAG = 20.0
POLE = 0.7


def armed(limits: SupervisionLimits = JACKET) -> LoopMonitor:
    """A watch over a loop that has been calm since adaptive was asked for."""
    watch = LoopMonitor(limits, 0.0)
    assert look(watch) == Fallback.NONE
    return watch


def look(
    watch: LoopMonitor,
    *,
    error: float = 0.0,
    rest: float = 0.0,
    held: float = 0.0,
    saturated: bool = False,
    asked: bool = True,
) -> int:
    """One slow period; the reason that is kept after it."""
    watch.check(
        error=error,
        strayed=error,
        rest_distance=rest,
        pole=POLE,
        held_share=held,
        saturated=saturated,
        asked=asked,
    )
    return watch.fallback


def first(reasons: list[int], expected: int = 0) -> int | None:
    """Periods until the first reason, which is the expected one."""
    found = next((i for i, reason in enumerate(reasons) if reason), None)
    assert found is None or not expected or reasons[found] == expected
    return found


@pytest.mark.parametrize(
    ("rests", "expected"),
    [
        ([1.0] * 300, 240),
        ([0.0] * 10_000, None),
        ([0.05] * 10_000, None),
        ([5.0 * math.exp(-k / 600.0) for k in range(3000)], None),  # on its way to rest
        ([1.0] + [0.9] * 300, 240),
        ([1.0] + [0.8999] * 300, 241),  # a tenth of the way begins the wait anew
        ([0.1 + 0.01 * k for k in range(300)], 240),
        ([1.0] * 200 + [math.nan] + [1.0] * 300, 201 + 240),
    ],
)
def test_a_limit_away_from_rest_falls_back(rests: list[float], expected: int | None) -> None:
    """The input is at its limit in all periods but where there is no number."""
    watch = armed()
    reasons = [look(watch, rest=rest, saturated=not math.isnan(rest)) for rest in rests]
    assert first(reasons, Fallback.SATURATED) == expected


LATE = int(TIME_CONSTANTS / (1.0 - POLE))
"""Slow periods of ten time constants of the loop."""


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([0.5] * 40, LATE),
        ([0.4] * 300, None),
        ([-0.39] * 300, None),
        ([0.5] * 30 + [0.1] + [0.5] * 40, 31 + LATE),
    ],
)
def test_a_large_error_with_a_free_input_falls_back(
    errors: list[float], expected: int | None
) -> None:
    watch, limited = armed(), armed()
    assert first([look(watch, error=error) for error in errors], Fallback.ERROR) == expected
    assert not any(look(limited, error=9.0, saturated=True) for _ in range(300))


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([0.06 * (-1.2) ** k for k in range(12)], SWINGS),
        ([0.05 * (-1.2) ** k for k in range(12)], SWINGS),
        ([0.049 * (-1.2) ** k for k in range(12)], SWINGS + 1),
        ([0.001 * (-1.2) ** k for k in range(20)], None),
        ([0.06 * (-1.0) ** k for k in range(12)], None),
        # a swing that does not grow begins the count anew
        ([0.06 * 1.2 ** (k - (k > SWINGS - 2)) * (-1.0) ** k for k in range(2 * SWINGS)], None),
        ([0.06 * 1.2**k * (k % 2) for k in range(40)], None),
        ([0.06 * 1.2**k * (1.0 + k % 2) for k in range(20)], None),
        # each side lasts three periods, and its peak is its largest error
        (
            [0.06 * share * (-1.2) ** k for k in range(10) for share in (0.5, 1.0, 0.001)],
            3 * SWINGS,
        ),
    ],
)
def test_swings_that_grow_fall_back_when_they_are_enough_in_a_row(
    errors: list[float], expected: int | None
) -> None:
    watch = armed(replace(JACKET, error_limit=0.0))
    reasons = [look(watch, error=error) for error in errors]
    assert first(reasons, Fallback.OSCILLATING) == expected


@pytest.mark.parametrize(("held", "expected"), [(0.5, 0), (0.51, Fallback.BLIND)])
def test_failed_measurements_fall_back(held: float, expected: int) -> None:
    assert look(armed(), held=held) == expected


def test_a_fallback_stays_until_adaptive_is_asked_for_anew() -> None:
    """Asking forgets the errors that the watch has counted; without adaptive nothing is latched."""
    watch = LoopMonitor(JACKET, 0.0)
    assert not any(look(watch, error=0.5, asked=False) for _ in range(2 * LATE))
    assert first([look(watch, error=0.5) for _ in range(2 * LATE)], Fallback.ERROR) == LATE + 1
    assert look(watch, error=0.5, held=1.0) == Fallback.ERROR
    assert look(watch, asked=False) == Fallback.ERROR
    assert look(watch, held=1.0) == Fallback.NONE
    assert first([look(watch, error=0.5) for _ in range(2 * LATE)], Fallback.ERROR) == LATE


def test_asking_for_adaptive_forgets_the_swings_that_were_counted() -> None:
    watch = LoopMonitor(replace(JACKET, error_limit=0.0), 0.0)
    errors = [0.06 * (-1.2) ** k for k in range(12 + 2 * SWINGS)]
    assert not any(look(watch, error=error, asked=False) for error in errors[:12])
    reasons = [look(watch, error=error) for error in errors[12:]]
    assert first(reasons, Fallback.OSCILLATING) == SWINGS


def troubled(fallback: Fallback) -> LoopMonitor:
    """A watch that has fallen back for a reason in this period."""
    watch, last = armed(), Fallback.NONE
    causes: dict[Fallback, list[dict[str, Any]]] = {
        Fallback.BLIND: [{"held": 1.0}],
        Fallback.SATURATED: [{"rest": 1.0, "saturated": True}] * 241,
        Fallback.ERROR: [{"error": 0.5}] * (LATE + 1),
        Fallback.OSCILLATING: [{"error": 0.06 * (-1.2) ** k} for k in range(SWINGS + 1)],
    }
    for cause in causes[fallback]:
        assert last == Fallback.NONE
        last = Fallback(look(watch, **cause))
    assert last == fallback
    return watch


@pytest.mark.parametrize(
    ("fallback", "ends"),
    [
        (Fallback.BLIND, True),
        (Fallback.SATURATED, True),
        (Fallback.ERROR, True),
        (Fallback.OSCILLATING, False),
    ],
)
def test_a_fallback_ends_when_its_cause_is_gone_but_for_a_loop_that_swings_by_itself(
    fallback: Fallback, ends: bool
) -> None:
    """What is left are swings far too small to count."""
    watch = troubled(fallback)
    reasons = [look(watch, error=0.001 * (-1.0) ** k) for k in range(100)]
    end = Fallback.NONE if ends else fallback
    assert reasons == [fallback] * (WINDOW - 1) + [end] * (101 - WINDOW)


@pytest.mark.parametrize("left", [{"rest": 1.0, "saturated": True}, {"error": 0.5}])
def test_what_is_left_of_a_cause_keeps_the_fallback(left: dict[str, Any]) -> None:
    """For longer than a fallback lasts, but not for as long as would be a reason of its own."""
    assert WINDOW < LATE
    watch = troubled(Fallback.BLIND)
    for _ in range(LATE):
        assert look(watch, **left) == Fallback.BLIND
    assert [look(watch) for _ in range(WINDOW)][-2:] == [Fallback.BLIND, Fallback.NONE]


def response(
    lag_s: float,
    gain: float,
    before: float,
    after: float,
    *,
    dead: bool = False,
    seconds: int = 600,
) -> int | None:
    """Seconds until a trip, of a load that rests at one input and gets another one, its limit."""
    watch, output = LoopMonitor(JACKET, before), gain * before
    for second in range(seconds):
        if not dead:
            output += (1.0 - math.exp(-1.0 / lag_s)) * (gain * after - output)
        if watch.check_response(after, LAG, output, saturated=True):
            return second
    return None


def test_a_moment_off_the_limit_begins_the_wait_for_a_response_anew() -> None:
    watch = LoopMonitor(JACKET, 3.0)
    trips = [watch.check_response(4.4 + 0.1 * k, LAG, 3.0, saturated=k != 100) for k in range(222)]
    assert trips == [False] * 221 + [True]


@pytest.mark.parametrize(("moved", "trips"), [(0.0499, True), (0.05, False), (-0.05, False)])
def test_a_movement_of_the_response_distance_is_an_answer(moved: float, trips: bool) -> None:
    """Measured from where the output was when the input came to its limit."""
    watch = LoopMonitor(JACKET, 0.0)
    outputs = [0.0, moved, *[0.0] * 300]
    found = [watch.check_response(4.4, LAG, y, saturated=True) for y in outputs]
    assert found == [False] * 120 + [trips] * 182


@pytest.mark.parametrize(("step", "trips"), [(0.3205, False), (0.3215, True)])
def test_the_smallest_load_must_move_by_the_response_distance(step: float, trips: bool) -> None:
    """A fifth of the way of the faster lag, of 4 periods, after the first period at the limit."""
    assert (0.2 * step * math.exp(-1.0 / 4.0) > 0.05) is trips
    watch = LoopMonitor(JACKET, 3.0)
    for _ in range(5000):
        found = watch.check_response(3.0 + step, LAG, 3.0, saturated=True)
    assert found is trips


@given(st.floats(0.2, 6.0), st.floats(0.2, 6.0), st.floats(2.2, 4.4), st.sampled_from([2.2, 4.4]))
def test_no_load_within_the_bounds_trips(
    lag: float, gain: float, before: float, after: float
) -> None:
    assert response(lag * LAG, gain, before, after, seconds=2000) is None


def test_a_dead_sensor_trips_after_the_waiting_time_unless_the_limit_is_near() -> None:
    assert response(LAG, 1.0, 3.0, 4.4, dead=True) == 120
    assert response(LAG, 1.0, 4.3, 4.4, dead=True, seconds=5000) is None


BETTER = 5.0
WAYS = 60
LONGEST = 60
"""Slow periods."""


def cycle_found(
    positions: Iterable[float],
    *,
    better: float = BETTER,
) -> int | None:
    """Periods until a limit cycle is found at a constant set-point."""
    watch = CycleMonitor(0.01)
    for number, position in enumerate(positions):
        if watch.check(position, 1.0, better, fixed=True):
            return number
    return None


@pytest.mark.parametrize("half", [1, 5, 40])
def test_an_input_that_goes_from_limit_to_limit_is_found(half: int) -> None:
    course = ([0.0] * half + [1.0] * half) * WAYS
    assert cycle_found(course) == WAYS * half


@pytest.mark.parametrize(
    ("course", "period"),
    [
        (([0.0] + [0.5] * LONGEST + [1.0] + [0.5] * LONGEST) * 100, None),
        (([0.0] + [0.5] * (LONGEST - 1) + [1.0] + [0.5] * (LONGEST - 1)) * 100, WAYS * LONGEST),
        # a pause begins the count anew
        ([0.0, 1.0] * 20 + [0.5] * (LONGEST + 1) + [0.0, 1.0] * 100, 40 + LONGEST + 1 + WAYS),
    ],
)
def test_ways_far_apart_are_none(course: list[float], period: int | None) -> None:
    assert cycle_found(course) == period


@pytest.mark.parametrize(
    ("low", "high", "cycles"),
    [
        (AT_LIMIT, 1.0 - AT_LIMIT, True),
        (0.0999, 0.9001, True),
        (0.101, 0.9, False),
        (0.0999, 0.899, False),
        (-0.5, 1.5, True),
    ],
)
def test_a_tenth_of_the_range_from_a_limit_is_at_the_limit(
    low: float, high: float, cycles: bool
) -> None:
    assert (cycle_found([low, high] * 200) is not None) is cycles


@pytest.mark.parametrize(("better", "cycles"), [(3.0, False), (3.01, True)])
def test_an_estimate_must_predict_three_times_better(better: float, cycles: bool) -> None:
    assert (cycle_found([0.0, 1.0] * 200, better=better) is not None) is cycles


@pytest.mark.parametrize(("step", "cycles"), [(0.0078125, True), (0.0079, False)])
def test_a_set_point_that_trembles_by_less_than_its_step_rests(step: float, cycles: bool) -> None:
    watch = CycleMonitor(0.0078125)
    seen = [watch.check(float(k % 2), 1.0 + (k % 2) * step, BETTER, fixed=True) for k in range(200)]
    assert any(seen) is cycles


def test_the_adaptive_controller_begins_the_count_anew() -> None:
    watch = CycleMonitor(0.01)
    fixed = [True] * 50 + [False] + [True] * 200
    seen = [watch.check(float(k % 2), 1.0, BETTER, f) for k, f in enumerate(fixed)]
    assert not any(seen[:50])
    # at the period of the other controller the input arrives at a limit already
    assert seen.index(True) == 50 + WAYS
