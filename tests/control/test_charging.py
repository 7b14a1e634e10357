"""Charging a battery that is simulated as a rising voltage behind a resistance."""

from dataclasses import replace

import pytest

from adaptdrive.config.load import Charge
from adaptdrive.control.charging import (
    ChargeState,
    Charging,
    begin_anew,
    highest_boost_voltage,
    is_complete,
    is_disconnected,
    is_too_long,
    proven_current,
    taper,
    terminal_voltage,
    voltage_limit,
)

LIMITS = Charging(
    turns_ratio=0.25, droop_Ohm=1.0, internal_Ohm=0.2, voltage_max_V=58.0, end_current_A=1.0
)


def charge(setpoint_A: float, periods: int) -> list[tuple[float, float, bool]]:
    """Current, terminal voltage and whether it is full; the EMF rises with the charge."""
    state, emf_V, current_A, trace = ChargeState(0.0), 54.0, 0.0, []
    for _ in range(periods):
        terminal_V = emf_V + LIMITS.internal_Ohm * current_A
        current_A = taper(LIMITS, state, setpoint_A, terminal_V, current_A)
        emf_V += 2e-4 * current_A
        trace.append((current_A, terminal_V, is_complete(LIMITS, state)))
    return trace


def test_it_charges_with_the_set_point_then_at_the_limit_of_the_voltage_and_ends() -> None:
    trace = charge(10.0, 6000)
    currents = [current for current, *_ in trace]
    constant = currents.index(max(currents))
    assert max(currents) == 10.0
    assert max(voltage for _, voltage, _ in trace) < 58.0 + 0.05
    assert all(0.0 <= current <= 10.0 for current in currents)
    tail = currents[constant + 1000 :]
    assert tail == sorted(tail, reverse=True)
    full = [done for *_, done in trace].index(True)
    assert trace[full][0] < 1.0
    assert trace[full][1] == pytest.approx(58.0, rel=0.01)


def test_the_terminal_voltage_is_what_the_droop_leaves() -> None:
    assert terminal_voltage(LIMITS, 280.0, 10.0) == 60.0


@pytest.mark.parametrize(("current_A", "boost_V"), [(10.0, 272.0), (0.0, 232.0), (-5.0, 232.0)])
def test_a_voltage_puts_the_terminals_at_their_limit(current_A: float, boost_V: float) -> None:
    assert highest_boost_voltage(LIMITS, current_A) == boost_V


@pytest.mark.parametrize(("reads_A", "proven_A"), [(9.0, 9.0), (10.0, 10.0), (15.0, 10.0)])
def test_no_current_lowers_the_terminals_that_the_power_cannot_carry(
    reads_A: float, proven_A: float
) -> None:
    """280 V at the boost capacitor are 70 V behind the transformer: 700 W are 10 A."""
    assert proven_current(LIMITS, reads_A, 280.0, 700.0) == proven_A
    assert proven_current(LIMITS, reads_A, 0.0, 0.0) == 0.0


def test_the_current_falls_by_a_twentieth_of_what_the_resistance_asks_for() -> None:
    state = ChargeState(10.0)
    assert taper(LIMITS, state, 20.0, 58.4, 10.0) == pytest.approx(10.0 - 0.05 * 0.4 / 0.2)
    assert taper(LIMITS, state, 20.0, 57.6, 10.0) == pytest.approx(10.0)
    assert taper(LIMITS, state, 9.0, 57.6, 10.0) == 9.0
    assert taper(LIMITS, state, 9.0, 1000.0, 10.0) == 0.0


def ending(terminal_V: float, current_A: float, allowed_A: float, setpoint_A: float = 10.0) -> int:
    """Periods of the end after one at a terminal voltage, with what it allows then."""
    state = ChargeState(allowed_A - 0.05 * (58.0 - terminal_V) / 0.2, ending_periods=4)
    taper(LIMITS, state, setpoint_A, terminal_V, current_A)
    assert state.current_A == pytest.approx(min(max(allowed_A, 0.0), setpoint_A))
    return state.ending_periods


@pytest.mark.parametrize(
    ("terminal_V", "current_A", "allowed_A", "expected"),
    [
        (58.0, 0.9, 0.9, 5),
        (0.99 * 58.0, 0.9, 0.9, 5),  # the taper never reaches all of it
        (0.989 * 58.0, 0.9, 0.9, 0),
        (58.0, 1.0, 0.9, 0),
        (58.0, 0.9, 1.0, 0),
        (58.0, 0.99, 0.99, 5),
        (70.0, -3.0, -2.0, 5),
    ],
)
def test_the_end_is_near_the_voltage_with_both_currents_below_the_last(
    terminal_V: float, current_A: float, allowed_A: float, expected: int
) -> None:
    assert ending(terminal_V, current_A, allowed_A) == expected


def test_a_set_point_that_is_all_that_is_allowed_is_not_the_end() -> None:
    assert ending(58.0, 0.5, 0.5, setpoint_A=0.5) == 0
    assert ending(58.0, 0.5, 0.5, setpoint_A=0.51) == 5


def test_ten_periods_at_the_end_are_full() -> None:
    state, seen = ChargeState(0.5), []
    for _ in range(12):
        taper(LIMITS, state, 10.0, 58.0, 0.5)
        seen.append(is_complete(LIMITS, state))
    assert seen == [False] * 9 + [True] * 3


def ended(currents_A: list[float], setpoint_A: float = 10.0) -> tuple[bool, bool]:
    """Whether a charge at the limit is complete, and whether its battery is gone."""
    state = ChargeState(currents_A[0])
    for current_A in currents_A:
        state.current_A = min(state.current_A, 1.5 * current_A + 0.1)
        taper(LIMITS, state, setpoint_A, 58.1, current_A)
    return is_complete(LIMITS, state), is_disconnected(LIMITS, state)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.9, 0.99])
def test_a_current_that_tapers_is_complete_however_fast(share: float) -> None:
    currents_A = [10.0 * share**k for k in range(600)]
    assert ended(currents_A) == (True, False)


def test_a_current_that_tapers_more_slowly_than_what_is_asked_for_is_complete() -> None:
    state, current_A = ChargeState(4.5), 4.5
    while current_A > 0.01:
        taper(LIMITS, state, 10.0, 58.0 + 4.5 * current_A, current_A)
        current_A *= 0.75
    assert (is_complete(LIMITS, state), is_disconnected(LIMITS, state)) == (True, False)


@pytest.mark.parametrize(
    ("left_A", "gone"), [(1.0, False), (3.9, False), (4.5, True), (10.0, True)]
)
def test_a_current_that_leaves_in_one_step_is_no_full_battery(left_A: float, *, gone: bool) -> None:
    state = ChargeState(left_A)
    taper(LIMITS, state, 10.0, 58.0, left_A)
    for _ in range(60):
        taper(LIMITS, state, 10.0, 58.0 * 1.02, 0.0)
    assert (is_complete(LIMITS, state), is_disconnected(LIMITS, state)) == (not gone, gone)


@pytest.mark.parametrize("current_A", [10.0, 0.5, 0.0, -0.5])
def test_a_charge_that_begins_anew_is_a_new_charge(current_A: float) -> None:
    """It goes on from the current that flows, which a battery does not give back."""
    state = ChargeState(4.5)
    taper(LIMITS, state, 10.0, 58.0, 4.5)
    for _ in range(60):
        taper(LIMITS, state, 10.0, 58.0 * 1.02, 0.0)
    assert is_disconnected(LIMITS, state)
    begin_anew(state, current_A)
    assert state == ChargeState(max(0.0, current_A))
    assert (is_complete(LIMITS, state), is_disconnected(LIMITS, state)) == (False, False)


def test_a_set_point_that_was_lowered_explains_a_current_that_left() -> None:
    state = ChargeState(10.0)
    taper(LIMITS, state, 10.0, 58.0, 10.0)
    for _ in range(60):
        taper(LIMITS, state, 2.0, 58.0 * 1.02, 0.0)
    assert is_complete(LIMITS, state)


@pytest.mark.parametrize(("lasted_s", "trips"), [(0.0, False), (3600.0, False), (3601.0, True)])
def test_a_charge_may_last_for_its_longest_time(lasted_s: float, *, trips: bool) -> None:
    state = ChargeState(10.0, lasted_s=lasted_s)
    assert is_too_long(replace(LIMITS, longest_s=3600.0), state) is trips
    assert not is_too_long(LIMITS, state)


@pytest.mark.parametrize("current_A", [0.0, 14.0])
def test_the_terminals_may_be_as_far_above_the_limit_as_its_key_says(current_A: float) -> None:
    highest_V = terminal_voltage(LIMITS, voltage_limit(LIMITS, current_A), current_A)
    share = highest_V / LIMITS.voltage_max_V - 1.0
    assert f"by {100.0 * share:.3g} % at most" in str(Charge.model_fields["voltage_max_V"])
