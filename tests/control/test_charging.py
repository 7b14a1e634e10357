"""Charging a battery that is simulated as a rising voltage behind a resistance."""

import pytest

from adaptdrive.control.charging import ChargeState, Charging, is_complete, taper, terminal_voltage

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
        trace.append((current_A, terminal_V, is_complete(state)))
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


def test_a_small_set_point_far_from_full_is_not_the_end() -> None:
    assert not any(done for *_, done in charge(0.5, 200))


def test_a_small_set_point_just_below_the_limit_is_not_the_end() -> None:
    state = ChargeState(0.5)
    for _ in range(30):
        taper(LIMITS, state, 0.5, 57.9, 0.5)
    assert not is_complete(state)


def test_the_terminal_voltage_is_what_the_droop_leaves() -> None:
    assert terminal_voltage(LIMITS, 280.0, 10.0) == 60.0
