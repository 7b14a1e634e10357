"""The watch: each of its rules, one at a time, and what must not set it off."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.settings import Jacket
from adaptdrive.control.watch import (
    Fallback,
    WatchState,
    latch_fallback,
    watch_loop,
    watch_response,
)

JACKET = Jacket(
    warm_up_periods=0,
    ratio_min=0.2,
    ratio_max=6.0,
    patience_periods=0,
    saturated_periods=240,
    error_limit=0.4,
    swing_min=0.05,
    response_periods=120,
    response_distance=0.05,
)
LAG = 20.0


def look(
    state: WatchState,
    *,
    error: float = 0.0,
    rest: float = 0.0,
    held: float = 0.0,
    saturated: bool = False,
    jacket: Jacket = JACKET,
) -> int:
    return watch_loop(state, jacket, error, error, rest, 0.7, held, saturated)


def first(reasons: list[int]) -> int | None:
    """Periods until the first reason."""
    return next((i for i, reason in enumerate(reasons) if reason), None)


def test_a_limit_away_from_rest_falls_back() -> None:
    state = WatchState()
    reasons = [look(state, rest=1.0, saturated=True) for _ in range(300)]
    assert first(reasons) == 240
    assert reasons[-1] == Fallback.SATURATED


@pytest.mark.parametrize("rest", [0.0, 0.05])
def test_an_output_at_rest_stays_at_a_limit_for_ever(rest: float) -> None:
    state = WatchState()
    assert not any(look(state, rest=rest, saturated=True) for _ in range(10_000))


def test_an_output_on_its_way_to_rest_may_take_long() -> None:
    state = WatchState()
    course = [5.0 * math.exp(-k / 600.0) for k in range(3000)]
    assert not any(look(state, rest=distance, saturated=True) for distance in course)


def test_an_output_that_leaves_its_rest_falls_back() -> None:
    state = WatchState()
    reasons = [look(state, rest=0.1 + 0.01 * k, saturated=True) for k in range(300)]
    assert first(reasons) == 240


def test_a_large_error_with_a_free_input_falls_back() -> None:
    state = WatchState()
    reasons = [look(state, error=0.5) for _ in range(40)]
    assert first(reasons) == 33  # ten time constants of 1 / (1 - 0.7) periods
    assert reasons[-1] == Fallback.ERROR


def test_a_step_over_the_whole_range_is_settled_before_it_falls_back() -> None:
    """Four equal poles at 0.7 need 6.7 time constants, 22 periods, to a tenth of a step."""
    state = WatchState()
    whole = 4.5  # the limit is a tenth of it
    waits = [(1.0 - 0.7) * k for k in range(200)]
    errors = [whole * math.exp(-x) * sum(x**i / math.factorial(i) for i in range(4)) for x in waits]
    jacket = replace(JACKET, error_limit=0.1 * whole)
    assert sum(error > jacket.error_limit for error in errors) in {22, 23}
    assert not any(look(state, error=error, jacket=jacket) for error in errors)


@pytest.mark.parametrize(("error", "saturated"), [(0.4, False), (-0.39, False), (9.0, True)])
def test_a_small_error_or_a_limit_is_no_trouble(error: float, saturated: bool) -> None:
    state = WatchState()
    assert not any(look(state, error=error, saturated=saturated) for _ in range(300))


@pytest.mark.parametrize(("growth", "expected"), [(1.2, Fallback.OSCILLATING), (1.0, 0)])
def test_swings_fall_back_only_if_they_grow(growth: float, expected: int) -> None:
    state = WatchState()
    jacket = replace(JACKET, error_limit=0.0)
    reasons = [look(state, error=0.06 * (-growth) ** k, jacket=jacket) for k in range(12)]
    assert reasons[-1] == expected


def test_swings_below_the_smallest_peak_do_not_count() -> None:
    state = WatchState()
    reasons = [look(state, error=0.001 * (-1.2) ** k) for k in range(20)]
    assert not any(reasons)


@pytest.mark.parametrize(("held", "expected"), [(0.5, 0), (0.51, Fallback.BLIND)])
def test_failed_measurements_fall_back(held: float, expected: int) -> None:
    assert look(WatchState(), held=held) == expected


def test_a_fallback_stays_until_adaptive_is_asked_for_anew() -> None:
    state = WatchState()
    latch_fallback(state, 0, asked=True)
    latch_fallback(state, Fallback.ERROR, asked=True)
    latch_fallback(state, 0, asked=True)
    assert state.fallback == Fallback.ERROR
    latch_fallback(state, 0, asked=False)
    assert state.fallback == Fallback.ERROR
    latch_fallback(state, 0, asked=True)
    assert state.fallback == Fallback.NONE


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
    state, output = WatchState(fast=before, slow=before), gain * before
    for second in range(seconds):
        if not dead:
            output += (1.0 - math.exp(-1.0 / lag_s)) * (gain * after - output)
        if watch_response(state, JACKET, after, LAG, output, saturated=True):
            return second
    return None


def test_a_dead_sensor_trips_after_the_waiting_time() -> None:
    assert response(LAG, 1.0, 3.0, 4.4, dead=True) == 120


@given(st.floats(0.2, 6.0), st.floats(0.2, 6.0), st.floats(2.2, 4.4), st.sampled_from([2.2, 4.4]))
def test_no_load_within_the_bounds_trips(
    lag: float, gain: float, before: float, after: float
) -> None:
    assert response(lag * LAG, gain, before, after, seconds=2000) is None


def test_a_limit_close_to_the_present_input_does_not_trip() -> None:
    assert response(LAG, 1.0, 4.3, 4.4, dead=True, seconds=5000) is None
