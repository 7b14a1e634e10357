"""Mode manual of the state machine: what V_c is, who may set it, and how long it stays."""

from __future__ import annotations

import pytest

from adaptdrive.control.reach import UNKNOWN, Reach
from adaptdrive.control.signals import Mode, Stage
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Reset,
    SetMode,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from tests.runtime.test_machine import LIMITS, REACH, SQUARE, Desk

SLEW_V = 0.5
"""Of V_c in one tick."""


def running(output: float = 3.0, *, govern: bool = False) -> Desk:
    desk = Desk(reach=REACH, govern=govern)
    desk.ask(Enable(), output)
    desk.pass_ticks(2)
    return desk


def by_hand(voltage_V: float = 300.0) -> Desk:
    desk = running()
    desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, voltage_V)
    return desk


def test_a_voltage_that_may_be_negative_begins_at_zero() -> None:
    desk = Desk(floor_V=-60.0)
    assert desk.machine.manual.value(0) == 0.0
    desk.ask(Enable(), 3.0)
    assert desk.machine.manual.value(desk.tick) == 0.0


def test_a_new_machine_is_not_confirmed_off_and_has_the_lowest_voltage() -> None:
    machine = Machine(LIMITS, pole=0.7)
    assert not machine.stopped
    assert not machine.coasting
    assert machine.obstacle == ""
    assert machine.manual.value(0) == LIMITS.floor_V
    machine.latch("x")
    machine.reset(None)
    assert machine.state is State.STOPPING


@pytest.mark.parametrize(
    ("in_force_V", "held_V"),
    [(300.0, 300.0), (100.0, 200.0), (500.0, 400.0), (float("nan"), 200.0)],
)
def test_manual_holds_the_voltage_in_force(in_force_V: float, held_V: float) -> None:
    desk = by_hand(in_force_V)
    assert desk.machine.mode is Mode.MANUAL
    assert [desk.machine.manual_V(desk.tick + n) for n in (0, 1, 1000)] == [held_V] * 3


def test_there_is_no_manual_voltage_in_another_mode() -> None:
    assert running().machine.manual_V(1000) == 0.0


def test_manual_ends_a_waveform_and_so_does_its_end() -> None:
    desk = running()
    desk.ask(SetWaveform(SQUARE))
    desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, 300.0)
    assert desk.machine.waveform is None


def test_a_change_between_controllers_keeps_waveform_and_set_point() -> None:
    desk = running()
    desk.ask(SetWaveform(SQUARE))
    desk.ask(SetMode(Mode.ADAPTIVE), output=4.0)
    assert desk.machine.mode is Mode.ADAPTIVE
    assert desk.machine.waveform is SQUARE
    assert desk.machine.setpoint == 3.0


def test_asking_for_manual_again_does_not_move_the_voltage() -> None:
    desk = by_hand(300.0)
    desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, 250.0)
    assert desk.machine.manual_V(desk.tick) == 300.0


@pytest.mark.parametrize(
    ("output", "setpoint"), [(3.5, 3.5), (9.0, REACH.high), (2.0, REACH.low), (-1.0, REACH.low)]
)
def test_after_manual_the_present_output_is_held_within_reach(
    output: float, setpoint: float
) -> None:
    """One below it is on its way there: V_c is at its lowest value at least."""
    desk = by_hand()
    desk.ask(SetMode(Mode.FIXED), output)
    assert desk.machine.setpoint == setpoint


@pytest.mark.parametrize(("output", "setpoint"), [(1.0, 1.0), (9.0, 4.5), (-1.0, 0.0)])
def test_a_coasting_drive_takes_its_output_for_its_set_point_after_manual(
    output: float, setpoint: float
) -> None:
    desk = Desk(reach=REACH)
    desk.ask(SetMode(Mode.MANUAL))
    desk.ask(Enable(), 3.0)
    desk.ask(SetMode(Mode.FIXED), output)
    assert desk.machine.coasting
    assert desk.machine.setpoint == setpoint


def test_a_drive_that_is_off_keeps_its_set_point_after_manual() -> None:
    desk = by_hand()
    desk.ask(Disable())
    desk.ask(SetMode(Mode.FIXED), output=1.0)
    assert desk.machine.setpoint == 3.0


def test_a_voltage_is_approached_at_the_slew_from_where_it_is() -> None:
    desk = by_hand(300.0)
    desk.ask(SetVoltage(310.0))
    desk.pass_ticks(4)
    assert desk.machine.manual_V(desk.tick) == 300.0 + 4 * SLEW_V
    desk.ask(SetVoltage(200.0))
    desk.pass_ticks(3)
    assert desk.machine.manual_V(desk.tick) == 302.0 - 3 * SLEW_V
    assert desk.machine.manual_V(desk.tick + 500) == 200.0


def test_a_voltage_needs_mode_manual_and_a_running_drive() -> None:
    running().refuses(SetVoltage(300.0), "voltage needs mode manual; mode is fixed")
    desk = Desk(reach=REACH)
    desk.ask(SetMode(Mode.MANUAL))
    desk.refuses(SetVoltage(300.0), "voltage needs a running drive; state is standby")
    desk.ask(Enable())
    desk.ask(SetVoltage(300.0))
    desk.refuses(SetVoltage(300.0), "voltage needs a running drive; state is starting")


@pytest.mark.parametrize("reach", [REACH, UNKNOWN])
def test_enabled_in_manual_it_coasts_until_a_voltage(reach: Reach) -> None:
    desk = Desk(reach=reach)
    desk.ask(SetMode(Mode.MANUAL))
    desk.ask(Enable(), output=3.0)
    desk.pass_ticks(1000)
    assert (desk.machine.state, desk.machine.stage) == (State.RUNNING, Stage.OFF)
    assert desk.machine.obstacle == "coasting with the bridge off until a voltage"
    desk.ask(SetVoltage(300.0))
    assert desk.state() is State.STARTING
    desk.pass_ticks(2)
    assert desk.machine.stage is Stage.RUN
    assert desk.machine.obstacle == ""


def test_the_time_until_the_next_voltage_begins_with_the_run() -> None:
    desk = Desk(reach=REACH)
    desk.ask(SetMode(Mode.MANUAL))
    desk.ask(Enable())
    desk.ask(SetVoltage(300.0, hold_s=0.1))  # 12 ticks
    desk.pass_ticks(20, boost_voltage_V=150.0)
    seen = [desk.machine.state]
    for ticks in (12, 2):
        desk.pass_ticks(ticks)
        seen.append(desk.machine.state)
    assert seen == [State.STARTING, State.RUNNING, State.TRIPPED]


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (SetVoltage(199.9), "voltage = 199.9 V is outside 200…400 V"),
        (SetVoltage(400.1), "voltage = 400.1 V is outside 200…400 V"),
        (SetVoltage(float("nan")), "voltage = nan V is outside"),
        (SetVoltage(300.0, hold_s=0.0), "hold_s = 0 s is not above 0 s and at most 86400 s"),
        (SetVoltage(300.0, hold_s=float("inf")), "hold_s = inf s is not"),
    ],
)
def test_a_voltage_out_of_range_is_refused(request_: SetVoltage, reason: str) -> None:
    by_hand().refuses(request_, reason)


def test_an_operator_who_is_lost_trips_the_drive_when_the_time_is_over() -> None:
    desk = by_hand()
    desk.ask(SetVoltage(300.0, hold_s=0.1))  # 12 ticks
    desk.pass_ticks(12)
    assert desk.state() is State.RUNNING
    desk.pass_ticks(1)
    assert desk.machine.trip == "manual: no new voltage within the 0.1 s that its sender had set"


def test_a_part_of_a_tick_is_a_tick_of_holding() -> None:
    desk = by_hand()
    desk.ask(SetVoltage(300.0, hold_s=0.101))
    desk.pass_ticks(13)
    assert desk.state() is State.RUNNING


def test_a_new_voltage_begins_the_time_anew_and_one_without_a_time_ends_it() -> None:
    desk = by_hand()
    for _ in range(3):
        desk.ask(SetVoltage(300.0, hold_s=0.1))
        desk.pass_ticks(12)
    desk.ask(SetVoltage(301.0))
    desk.pass_ticks(1000)
    assert desk.state() is State.RUNNING


def test_the_time_of_the_hand_does_not_count_under_a_controller() -> None:
    desk = by_hand()
    desk.ask(SetVoltage(300.0, hold_s=0.1))
    desk.ask(SetMode(Mode.FIXED), output=3.0)
    desk.pass_ticks(100)
    assert desk.state() is State.RUNNING


def test_a_set_point_and_a_waveform_are_refused_in_manual() -> None:
    desk = by_hand()
    desk.refuses(SetSetpoint(3.0), "setpoint needs mode fixed or adaptive; mode is manual")
    desk.refuses(SetWaveform(SQUARE), "waveform needs mode fixed or adaptive; mode is manual")


def test_a_voltage_of_a_running_drive_does_not_start_it_anew() -> None:
    desk = by_hand()
    desk.ask(SetVoltage(250.0))
    assert desk.state() is State.RUNNING


def test_a_coasting_drive_says_which_set_points_start_it() -> None:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output=0.0)
    within = "coasting with the bridge off until a set-point within 2.2…4.4 V"
    assert desk.machine.obstacle == within


def test_enabling_again_begins_manual_at_the_lowest_voltage() -> None:
    desk = by_hand(390.0)
    desk.ask(Disable())
    desk.machine.confirm_stop()
    desk.ask(Enable(), output=3.0)
    assert desk.machine.manual_V(desk.tick) == LIMITS.floor_V


def test_without_governing_a_set_point_stays_as_it_was_asked_for() -> None:
    desk = running(output=4.3)
    desk.machine.reach = Reach(2.0, 4.0)
    assert desk.machine.reference(desk.tick) == 4.3
    desk.machine.forget_reach()
    assert desk.machine.reach == REACH


def test_a_waveform_that_leaves_the_reach_is_no_obstacle_unless_governed() -> None:
    desk = running()
    desk.ask(SetWaveform(Waveform(Shape.SQUARE, 3.0, 4.2, 60.0)))
    desk.machine.reach = Reach(2.0, 4.0)
    assert desk.machine.obstacle == ""


@pytest.mark.parametrize(
    ("low", "high", "governed"), [(3.0, 4.0, False), (2.0, 4.0, True), (3.0, 4.45, True)]
)
def test_a_governed_waveform_is_named_when_either_end_is_out_of_reach(
    low: float, high: float, *, governed: bool
) -> None:
    desk = running(govern=True)
    desk.ask(SetWaveform(Waveform(Shape.SQUARE, low, high, 60.0)))
    assert desk.machine.obstacle.startswith("set-point is governed") is governed


def test_a_doubted_stop_must_be_confirmed_again() -> None:
    desk = Desk()
    desk.machine.confirm_stop()
    desk.machine.doubt_stop()
    assert desk.state() is State.STOPPING
    assert not desk.machine.stopped
    desk.machine.confirm_stop()
    assert desk.state() is State.STANDBY
    assert desk.machine.stopped


def test_a_running_drive_confirms_no_stop_and_doubt_does_not_stop_it() -> None:
    desk = running()
    desk.machine.confirm_stop()
    assert not desk.machine.stopped
    desk.machine.doubt_stop()
    assert desk.state() is State.RUNNING
    assert desk.machine.stage is Stage.RUN


def test_a_trip_of_a_drive_that_is_off_is_reset_into_standby_unless_in_doubt() -> None:
    for doubted, state in ((False, State.STANDBY), (True, State.STOPPING)):
        desk = Desk()
        desk.machine.confirm_stop()
        desk.machine.latch("x")
        if doubted:
            desk.machine.doubt_stop()
        desk.ask(Reset())
        assert desk.state() is state


def test_enabling_after_a_trip_forgets_the_waveform() -> None:
    desk = running()
    desk.ask(SetWaveform(SQUARE))
    desk.machine.latch("x")
    desk.machine.confirm_stop()
    desk.ask(Reset())
    desk.ask(Enable(), output=3.5)
    assert desk.machine.waveform is None
    assert desk.machine.reference(desk.tick) == 3.5


@pytest.mark.parametrize(("output", "setpoint"), [(-0.5, 0.0), (0.4, 0.4), (-3.0, 0.0)])
def test_a_load_that_turns_backwards_coasts_at_a_set_point_of_0(
    output: float, setpoint: float
) -> None:
    desk = Desk(reach=REACH, reference_min=1.5)
    desk.ask(Enable(), output)
    assert desk.machine.coasting
    assert desk.machine.setpoint == setpoint


@pytest.mark.parametrize(("setpoint", "coasts"), [(-1.0, False), (-1.5, True), (0.0, False)])
def test_a_set_point_below_0_that_v_c_can_hold_is_held(setpoint: float, *, coasts: bool) -> None:
    desk = Desk(reach=Reach(-1.0, 4.0), reference_min=-2.0)
    desk.ask(Enable(), output=1.0)
    desk.pass_ticks(2)
    desk.ask(SetSetpoint(setpoint))
    assert desk.machine.coasting is coasts
