"""The way to a set-point: never faster than its slope, and exactly there at its end."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.control.signals import Mode, Stage
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, Enable, SetMode, SetSetpoint, SetWaveform
from tests.unit.runtime.test_machine import DRIVE, LOAD, REACH, SQUARE, Desk

TICK_S = DRIVE.half_cycle_s


def running_desk(output: float = 2.5, slope: float = 0.0, **limits: object) -> Desk:
    desk = Desk(load=LOAD.model_copy(update={"reference_slope": slope}), **limits)
    desk.ask(Enable(), output=output)
    desk.pass_ticks(2)
    assert desk.state() is State.RUNNING
    return desk


def references(desk: Desk, seconds: float) -> list[float]:
    """The reference at each tick, and what the daemon does between two."""
    found = []
    for _ in range(round(seconds / TICK_S)):
        desk.pass_ticks(1)
        found.append(desk.machine.order(desk.tick).reference)
        desk.machine.progress(desk.tick)
    return found


@given(
    st.lists(st.tuples(st.floats(0.0, 4.5), st.floats(0.01, 50.0), st.integers(1, 200)), min_size=1)
)
def test_the_reference_is_never_faster_than_its_slope(
    wishes: list[tuple[float, float, int]],
) -> None:
    desk = running_desk()
    last = desk.machine.order(desk.tick).reference
    for value, slope, ticks in wishes:
        desk.ask(SetSetpoint(value, slope))
        for reference in references(desk, ticks * TICK_S):
            assert abs(reference - last) <= slope * TICK_S * (1.0 + 1e-9) + 1e-12
            last = reference
    value, slope, _ = wishes[-1]
    arrived = references(desk, 4.5 / slope + 2.0 * TICK_S)
    assert arrived[-1] == value == desk.machine.asked.setpoint
    assert desk.machine.asked.ramp is None
    assert desk.machine.steady


@given(st.floats(0.0, 4.5), st.floats(0.01, 5.0), st.integers(0, 400))
def test_what_an_order_says_to_come_does_come(value: float, slope: float, ahead: int) -> None:
    desk = running_desk()
    desk.ask(SetSetpoint(value, slope))
    desk.pass_ticks(1)
    order = desk.machine.order(desk.tick)
    known = order.moving
    said = order.reference if known is None else known.value(desk.tick + ahead, TICK_S)
    later = [order.reference, *references(desk, ahead * TICK_S)]
    assert said == later[ahead]


def test_the_configured_slope_holds_where_a_command_gives_none() -> None:
    desk = running_desk(slope=0.5)
    desk.ask(SetSetpoint(3.0))
    assert references(desk, 1.0)[59] == pytest.approx(2.5 + 0.25)
    desk.ask(SetSetpoint(2.0, 100.0))
    assert references(desk, 1.0)[-1] == 2.0


@pytest.mark.parametrize("slope", [0.0, -1.0, math.inf, math.nan])
def test_a_slope_that_leads_nowhere_is_refused(slope: float) -> None:
    running_desk().refuses(SetSetpoint(3.0, slope), f"slope = {slope:.12g} is not a finite number")


def test_a_change_of_the_controller_leaves_the_way_as_it_is() -> None:
    desk = running_desk()
    desk.ask(SetSetpoint(3.5, 1.0))
    assert references(desk, 0.5)[-1] == pytest.approx(3.0)
    desk.ask(SetMode(Mode.ADAPTIVE))
    assert references(desk, 0.25)[-1] == pytest.approx(3.25)


def test_holding_stops_on_the_way() -> None:
    desk = running_desk()
    desk.ask(SetSetpoint(3.5, 1.0))
    references(desk, 0.5)
    desk.ask(SetWaveform(None))
    assert references(desk, 0.5)[-1] == pytest.approx(3.0)
    desk.ask(SetSetpoint(3.5, 1.0))
    desk.ask(SetWaveform(SQUARE))
    assert references(desk, 0.1)[-1] == SQUARE.high
    desk.ask(Disable())
    assert desk.machine.asked.moving is None


def test_a_drive_that_coasts_begins_where_it_is_and_waits_until_it_runs() -> None:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output=0.0)
    desk.ask(SetSetpoint(3.2, 1.0), output=0.0)
    desk.pass_ticks(100, boost_voltage_V=0.0)
    assert desk.state() is State.STARTING
    assert references(desk, 0.25 + TICK_S)[-1] == pytest.approx(REACH.low + 0.25)
    assert references(desk, 1.0)[-1] == 3.2


def test_the_way_to_rest_ends_where_v_c_cannot_hold_the_output() -> None:
    desk = running_desk(output=3.2, reach=REACH)
    desk.ask(SetSetpoint(0.0, 1.0))
    assert references(desk, 0.9)[-1] == pytest.approx(2.3)
    assert desk.machine.stage is Stage.RUN
    references(desk, 0.2)
    assert (desk.machine.coasting, desk.machine.asked.setpoint) == (True, 0.0)


def test_a_new_run_does_not_follow_the_way_of_the_one_before() -> None:
    desk = running_desk()
    desk.ask(SetSetpoint(3.5, 1.0))
    desk.ask(Disable())
    desk.machine.confirm_stop()
    desk.ask(Enable(), output=2.6)
    desk.pass_ticks(2)
    assert set(references(desk, 0.5)) == {2.6}
    assert replace(desk.machine.asked, setpoint=0.0).moving is None
