"""Probing: bounds, ends, and how long it may last."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.loads.battery import battery_load
from adaptdrive.control.loads.load import Charging
from adaptdrive.control.settings import Probing
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.supervision.setpoints import EXCURSIONS, half_periods, probe
from adaptdrive.control.supervision.state import SlowState
from adaptdrive.control.supervision.supervisor import Verdict
from tests.integration.closed_loop.bench import AT_REST, EXACT, LOW, MOTOR

PROBING = Probing(amplitude=0.09, stale_periods=300, lowest=0.0, highest=4.5)
ASKED = replace(AT_REST, steady=True)
HALF = half_periods(MOTOR, 0.7, 1.0)


def unknown_load() -> SlowState:
    """A slow half that never gets to know its load."""
    state = SlowState(EXACT, MOTOR, LOW, 270.0)
    state.supervisor.verdict = Verdict.UNCERTAIN
    return state


def shifts(state: SlowState, periods: int, sample: SlowSample = ASKED) -> list[float]:
    reference = sample.reference
    return [probe(PROBING, MOTOR, state, sample, reference) - reference for _ in range(periods)]


def probing() -> SlowState:
    """A slow half in the middle of its first excursion."""
    state = unknown_load()
    assert shifts(state, HALF + 5)[-1] == pytest.approx(PROBING.amplitude)
    return state


def test_a_load_that_is_not_found_is_not_probed_for_ever() -> None:
    found = shifts(unknown_load(), 5_000)
    moved = sum(shift != 0.0 for shift in found)
    period = EXCURSIONS * 2 * HALF + PROBING.stale_periods
    assert 0 < moved <= EXCURSIONS * HALF * math.ceil(5_000 / period)


def test_a_known_load_is_asked_again_once_it_is_old() -> None:
    state = unknown_load()
    state.supervisor.verdict = Verdict.TRUSTED
    state.estimator.unseen_periods = PROBING.stale_periods
    assert not any(shifts(state, 5 * HALF))
    state.estimator.unseen_periods += 1
    assert any(shifts(state, 5 * HALF))


@pytest.mark.parametrize(
    "other",
    [
        replace(ASKED, adaptive=False),
        replace(ASKED, adaptive=False, manual=True),
        replace(ASKED, steady=False),
        replace(ASKED, reference=3.1),
    ],
    ids=["fixed", "manual", "waveform", "another set-point"],
)
def test_another_request_ends_it_at_once(other: SlowSample) -> None:
    state = probing()
    assert not any(shifts(state, PROBING.stale_periods, other))
    assert state.probe.age_periods == 0


def test_a_load_that_is_known_in_the_middle_of_an_excursion_is_brought_back_first() -> None:
    state = probing()
    state.supervisor.verdict = Verdict.TRUSTED
    found = shifts(state, 5 * HALF)
    left = HALF - 4
    assert found == pytest.approx([0.09] * left + [0.0] * (5 * HALF - left))
    assert state.probe.pause_periods == PROBING.stale_periods - (3 * HALF + 3)


@pytest.mark.parametrize("contest", ["sum", "unseen", "verdict"])
def test_an_estimate_that_is_contested_or_unseen_does_not_end_it(contest: str) -> None:
    state = probing()
    state.supervisor.verdict = Verdict.TRUSTED
    if contest == "sum":
        state.estimator.detector.sum = 1.0
    elif contest == "unseen":
        state.estimator.unseen_periods = 2 * HALF
    else:
        state.supervisor.verdict = Verdict.SETTLING
    assert min(shifts(state, 3 * HALF)) == pytest.approx(-0.09)


@pytest.mark.parametrize(
    ("lowest", "highest", "levels"),
    [
        (0.0, LOW + 0.08, {-0.09, 0.0}),
        (LOW - 0.08, 9.0, {0.09, 0.0}),
        (LOW - 0.08, LOW + 0.08, {0.0}),
        (LOW - 0.09, LOW + 0.09, {-0.09, 0.0, 0.09}),
    ],
)
def test_it_goes_where_there_is_room(lowest: float, highest: float, levels: set[float]) -> None:
    for limits in (
        (replace(PROBING, lowest=lowest, highest=highest), ASKED),
        (PROBING, replace(ASKED, lowest=lowest, highest=highest)),
    ):
        state = unknown_load()
        found = {probe(limits[0], MOTOR, state, limits[1], LOW) for _ in range(8 * HALF)}
        assert {round(level - LOW, 9) for level in found} == levels


def test_a_charging_current_is_lowered_only_for_the_time_constant_of_the_battery() -> None:
    load = battery_load(0.25, 1.2, 0.4, 30.0, Charging(0.25, 1.0, 0.2, 82.0, 1.0))
    assert half_periods(load, 0.7, 1.0) == round(30.0 * 1.2 / 1.6)
    assert half_periods(load, 0.98, 1.0) == 196
    found = [probe(PROBING, load, state, ASKED, LOW) - LOW for state in [unknown_load()] * 1000]
    assert min(found) == pytest.approx(-PROBING.amplitude * LOW)
    assert max(found) == 0.0
    first = next(i for i, shift in enumerate(found) if shift)
    assert sum(shift < 0.0 for shift in found[first : first + 44]) == 22


def test_a_current_that_the_voltage_limit_lowers_gets_no_ripple() -> None:
    load = battery_load(0.25, 1.2, 0.4, 30.0, Charging(0.25, 1.0, 0.2, 82.0, 1.0))
    state = unknown_load()
    for _ in range(60):
        probe(PROBING, load, state, ASKED, LOW)
    assert state.probe.age_periods > 0
    lowered = LOW
    for _ in range(600):
        lowered *= 0.999
        assert probe(PROBING, load, state, ASKED, lowered) == lowered


def test_nothing_is_moved_before_anything_is_learnt() -> None:
    settling, state = replace(PROBING, settle_periods=100), unknown_load()
    for _ in range(500):
        assert probe(settling, MOTOR, state, ASKED, LOW) == LOW
    state.estimator.periods = 100
    assert any(probe(settling, MOTOR, state, ASKED, LOW) != LOW for _ in range(100))


USUALLY = st.sampled_from([True, True, True, False])


@st.composite
def requests(draw: st.DrawFn) -> tuple[int, bool, SlowSample]:
    """What is asked for during some slow periods, and whether the input is at a limit."""
    reference = draw(st.floats(0.0, 4.5))
    sample = replace(
        ASKED,
        reference=reference,
        output=reference + draw(st.floats(-0.1, 0.1)),
        adaptive=draw(USUALLY),
        steady=draw(USUALLY),
        lowest=draw(st.floats(0.0, 3.0) | st.just(math.nan)),
        highest=draw(st.floats(1.5, 5.0)),
    )
    return draw(st.integers(1, 100)), not draw(USUALLY), sample


@given(st.lists(requests(), min_size=1, max_size=8))
def test_it_leaves_no_bound_and_fights_nobody(asked: list[tuple[int, bool, SlowSample]]) -> None:
    state = unknown_load()
    for periods, saturated, sample in asked:
        state.saturated = saturated
        for _ in range(periods):
            moved = probe(PROBING, MOTOR, state, sample, sample.reference)
            assert abs(moved - sample.reference) <= PROBING.amplitude * (1.0 + 1e-9)
            if moved != sample.reference:
                assert not moved < max(0.0, sample.lowest)
                assert moved <= min(4.5, sample.highest)
                assert sample.adaptive
                assert sample.steady
                assert not saturated
