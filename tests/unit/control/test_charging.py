"""Charging a battery that is simulated as a rising voltage behind a resistance."""

from dataclasses import replace

import pytest

from adaptdrive.config.load import Charge
from adaptdrive.config.section import meanings_of
from adaptdrive.control.loads.battery import (
    ABOVE,
    ChargeState,
    battery_load,
    begin_anew,
    boost_voltage,
    is_complete,
    is_disconnected,
    is_too_long,
    proven_current,
    taper,
    terminal_voltage,
)
from adaptdrive.control.loads.load import Charging
from adaptdrive.control.signals import SlowSample
from adaptdrive.control.slow import slow_step
from adaptdrive.control.supervision.state import SlowState
from tests.integration.closed_loop.bench import AT_REST, EXACT

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


@pytest.mark.parametrize(("reads_A", "proven_A"), [(9.0, 9.0), (10.0, 10.0), (15.0, 10.0)])
def test_no_current_lowers_the_terminals_that_the_power_cannot_carry(
    reads_A: float, proven_A: float
) -> None:
    """280 V at the boost capacitor are 70 V behind the transformer: 700 W are 10 A."""
    assert proven_current(LIMITS, reads_A, 280.0, 700.0) == proven_A
    assert proven_current(LIMITS, reads_A, 0.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("terminal_V", "current_A", "allowed_A", "setpoint_A", "expected"),
    [
        (58.0, 0.9, 0.9, 10.0, 5),
        (0.99 * 58.0, 0.9, 0.9, 10.0, 5),  # the taper never reaches all of it
        (0.989 * 58.0, 0.9, 0.9, 10.0, 0),
        (58.0, 1.0, 0.9, 10.0, 0),
        (58.0, 0.9, 1.0, 10.0, 0),
        (58.0, 0.99, 0.99, 10.0, 5),
        (70.0, -3.0, -2.0, 10.0, 5),
        (58.0, 0.5, 0.5, 0.5, 0),  # a set-point that is all that is allowed
        (58.0, 0.5, 0.5, 0.51, 5),
    ],
)
def test_the_end_is_near_the_voltage_with_both_currents_below_the_last(
    terminal_V: float, current_A: float, allowed_A: float, setpoint_A: float, expected: int
) -> None:
    """Ten such periods in a row are a full battery."""
    state = ChargeState(allowed_A - 0.05 * (58.0 - terminal_V) / 0.2, ending_periods=4)
    taper(LIMITS, state, setpoint_A, terminal_V, current_A)
    assert state.current_A == pytest.approx(min(max(allowed_A, 0.0), setpoint_A))
    assert state.ending_periods == expected
    assert [is_complete(LIMITS, replace(state, ending_periods=n)) for n in (9, 10)] == [False, True]


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


@pytest.mark.parametrize(("lasted_s", "trips"), [(0.0, False), (3600.0, False), (3601.0, True)])
def test_a_charge_may_last_for_its_longest_time(lasted_s: float, *, trips: bool) -> None:
    state = ChargeState(10.0, lasted_s=lasted_s)
    assert is_too_long(replace(LIMITS, longest_s=3600.0), state) is trips
    assert not is_too_long(LIMITS, state)


@pytest.mark.parametrize("current_A", [0.0, 14.0])
def test_the_terminals_may_be_as_far_above_the_limit_as_its_key_says(current_A: float) -> None:
    highest_V = terminal_voltage(LIMITS, boost_voltage(LIMITS, ABOVE, current_A), current_A)
    share = highest_V / LIMITS.voltage_max_V - 1.0
    assert f"by {100.0 * share:.3g} % at most" in meanings_of(Charge)["voltage_max_V"]


RATIO, SERIES_Ohm, END_A = 0.25, 1.2, 1.0
BATTERY = battery_load(RATIO, SERIES_Ohm, 0.3, 60.0, Charging(RATIO, 1.0, 0.2, 58.0, END_A))
JACKET = replace(EXACT.supervision, response_periods=10, response_distance=0.2)
SETTINGS = replace(EXACT, supervision=JACKET)
LOWEST_V, HIGHEST_V = 100.0, 400.0


def sample(output_A: float, reference_A: float, newest_V: float, oldest_V: float) -> SlowSample:
    """Return a sample of a battery; the second of the filtered inputs is not the terminal's."""
    return replace(
        AT_REST, output=output_A, reference=reference_A, adaptive=False, applied=newest_V,
        output_filtered=[output_A], input_filtered=[newest_V, oldest_V],
        low=LOWEST_V, high=HIGHEST_V,
    )  # fmt: skip


def below_the_emf(newest_V: float) -> SlowState:
    """Return a slow half that has just raised its input to `newest_V`; no current flows."""
    state = SlowState(SETTINGS, BATTERY, 0.0, newest_V)
    state.inputs[1:] = [newest_V - 30.0] * (len(state.inputs) - 1)
    state.charge.current_A = 100.0  # so that the voltage limit lowers no set-point here
    return state


@pytest.mark.parametrize(
    ("reference_A", "current_A"), [(8.0, 8.0), (5.0, 5.0), (0.5, END_A), (END_A, END_A)]
)
def test_below_its_emf_a_battery_is_raised_by_what_the_set_point_needs_at_once(
    reference_A: float, current_A: float
) -> None:
    """N2 ΔV_c over R_s is the current that flows at once, if the EMF is reached."""
    state, before_V = below_the_emf(200.0), 200.0
    raised = []
    for _ in range(12):
        asked = sample(0.0, reference_A, before_V, 0.0)
        now_V = slow_step(SETTINGS, BATTERY, state, asked)
        raised.append(RATIO * (now_V - before_V) / SERIES_Ohm)
        before_V = now_V
    assert max(raised) == pytest.approx(current_A)
    assert before_V <= HIGHEST_V


@pytest.mark.parametrize(("high_V", "unresponsive"), [(HIGHEST_V, False), (250.0, True)])
def test_below_its_own_voltage_a_battery_need_not_answer(
    high_V: float, *, unresponsive: bool
) -> None:
    """At the highest input it must: that is above the voltage of every battery it is made for."""
    state = SlowState(SETTINGS, BATTERY, 0.0, 200.0)
    for number in range(60):
        asked = sample(0.0, 20.0, 250.0 if number else 200.0, 0.0)
        asked = replace(asked, followed=number == 0, high=high_V)
        slow_step(SETTINGS, BATTERY, state, asked)
    assert state.unresponsive is unresponsive
