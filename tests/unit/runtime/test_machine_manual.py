"""Mode manual of the state machine, and the limits of requests with the words of refusals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from adaptdrive.config.root import DriveLimits, Manipulated
from adaptdrive.control.signals import UNKNOWN, Mode, Reach, Shape, Stage, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from adaptdrive.runtime.settings import MachineLimits, ManualVoltage
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.errors import RefusedError
from tests.support import a_trip, text_of
from tests.unit.runtime.test_machine import DRIVE, LIMITS, LOAD, REACH, SQUARE, Desk

SLEW_V = 0.5
"""Of V_c in one tick."""


def running(output: float = 3.0) -> Desk:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output)
    desk.pass_ticks(2)
    return desk


def by_hand(voltage_V: float = 300.0) -> Desk:
    desk = running()
    desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, voltage_V)
    return desk


def test_a_voltage_is_approached_at_the_slew_from_where_it_is() -> None:
    desk = by_hand(300.0)
    desk.ask(SetVoltage(310.0))
    desk.pass_ticks(4)
    assert desk.machine.manual_V(desk.tick) == 300.0 + 4 * SLEW_V
    desk.ask(SetVoltage(200.0))
    desk.pass_ticks(3)
    assert desk.machine.manual_V(desk.tick) == 302.0 - 3 * SLEW_V
    assert desk.machine.manual_V(desk.tick + 500) == 200.0


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


def test_a_trip_of_a_drive_that_is_off_is_reset_into_standby_unless_in_doubt() -> None:
    for case, state in (
        ("", State.STANDBY),
        ("doubted", State.STOPPING),
        ("coasts", State.STOPPING),
    ):
        desk, doubted = Desk(reach=REACH), case == "doubted"
        desk.machine.confirm_stop()
        if case == "coasts":
            desk.ask(Enable(), output=0.0)
            assert desk.machine.obstacle == (
                "coasting with the bridge off until a set-point within 2.2…4.4 V"
            )
        desk.machine.latch(a_trip("x"))
        if doubted:
            desk.machine.withdraw_stop()
        desk.ask(Reset())
        assert desk.state() is state


@pytest.mark.parametrize(("output", "setpoint"), [(-0.5, 0.0), (0.4, 0.4), (-3.0, 0.0)])
def test_a_load_that_turns_backwards_coasts_at_a_set_point_of_0(
    output: float, setpoint: float
) -> None:
    desk = Desk(reach=REACH, load=LOAD.model_copy(update={"reference_min": 1.5}))
    desk.ask(Enable(), output)
    assert desk.machine.coasting
    assert desk.machine.asked.setpoint == setpoint


@pytest.mark.parametrize(("setpoint", "coasts"), [(-1.0, False), (-1.5, True), (0.0, False)])
def test_a_set_point_below_0_that_v_c_can_hold_is_held(setpoint: float, *, coasts: bool) -> None:
    desk = Desk(reach=Reach(-1.0, 4.0), load=LOAD.model_copy(update={"reference_min": -2.0}))
    desk.ask(Enable(), output=1.0)
    desk.pass_ticks(2)
    desk.ask(SetSetpoint(setpoint))
    assert desk.machine.coasting is coasts


@pytest.mark.parametrize(("floor_V", "rests_V"), [(200.0, 200.0), (-60.0, 0.0)])
def test_the_voltage_begins_at_the_lowest_or_at_zero_in_each_run(
    floor_V: float, rests_V: float
) -> None:
    limits = DriveLimits(boost_reference_min_V=floor_V)
    desk = Desk(drive=DRIVE.model_copy(update={"limits": limits}))
    assert [desk.machine.manual.value(tick) for tick in (0, 1)] == [rests_V] * 2
    desk.ask(Enable(), 3.0)
    desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, 390.0)
    desk.ask(Disable())
    desk.machine.confirm_stop()
    desk.ask(Enable(), 3.0)
    assert desk.machine.manual_V(desk.tick) == rests_V


@pytest.mark.parametrize(
    ("in_force_V", "held_V"),
    [(300.0, 300.0), (100.0, 200.0), (500.0, 400.0), (float("nan"), 200.0)],
)
def test_manual_holds_the_voltage_in_force_and_ends_a_waveform(
    in_force_V: float, held_V: float
) -> None:
    desk = running()
    desk.ask(SetWaveform(SQUARE))
    desk.ask(SetMode(Mode.ADAPTIVE), output=4.0)
    assert (desk.machine.asked.waveform, desk.machine.asked.setpoint) == (SQUARE, 3.0)
    assert desk.machine.manual_V(1000) == 0.0  # there is none in another mode
    for voltage_V in (in_force_V, 250.0):  # asked for again it does not move
        desk.machine.carry_out(SetMode(Mode.MANUAL), desk.tick, 3.0, None, voltage_V)
        assert (desk.machine.mode, desk.machine.asked.waveform) == (Mode.MANUAL, None)
        assert [desk.machine.manual_V(desk.tick + n) for n in (0, 1, 1000)] == [held_V] * 3
    desk.refuses(SetSetpoint(3.0), "setpoint needs mode fixed or adaptive; mode is manual")
    desk.refuses(SetWaveform(SQUARE), "waveform needs mode fixed or adaptive; mode is manual")


@pytest.mark.parametrize(
    ("drive", "output", "setpoint"),
    [
        ("runs", 3.5, 3.5),
        ("runs", 9.0, REACH.high),
        ("runs", -1.0, REACH.low),  # it is on its way: V_c is at its lowest value at least
        ("coasts", 1.0, 1.0),
        ("coasts", 9.0, 4.5),
        ("coasts", -1.0, 0.0),
        ("is off", 1.0, 3.0),
    ],
)
def test_after_manual_the_present_output_is_held_as_far_as_it_can_be(
    drive: str, output: float, setpoint: float
) -> None:
    desk = by_hand()
    if drive != "runs":
        desk.ask(Disable())
    if drive == "coasts":
        desk.machine.confirm_stop()
        desk.ask(Enable(), 3.0)
    desk.ask(SetMode(Mode.FIXED), output)
    assert desk.machine.coasting is (drive == "coasts")
    assert desk.machine.asked.setpoint == setpoint


def test_a_voltage_needs_mode_manual_and_a_running_drive() -> None:
    running().refuses(SetVoltage(300.0), "voltage needs mode manual; mode is fixed")
    desk = Desk(reach=REACH)
    desk.ask(SetMode(Mode.MANUAL))
    desk.refuses(SetVoltage(300.0), "voltage needs a running drive; state is standby")
    desk.ask(Enable())
    desk.ask(SetVoltage(300.0))
    desk.refuses(SetVoltage(300.0), "voltage needs a running drive; state is starting")
    by_hand().refuses(SetVoltage(199.9), "voltage = 199.9 V is outside 200…400 V")
    by_hand().refuses(SetVoltage(300.0, hold_s=0.0), "hold_s = 0 s is not above 0 s")


@pytest.mark.parametrize(
    ("hold_s", "then", "ticks", "trips"),
    [
        (0.1, None, 12, False),  # 12 ticks
        (0.1, None, 13, True),
        (0.101, None, 13, False),  # a part of a tick is one
        (0.1, SetVoltage(300.0, hold_s=0.1), 12, False),  # it begins anew
        (0.1, SetVoltage(301.0), 1000, False),
        (0.1, SetMode(Mode.FIXED), 1000, False),
    ],
)
def test_an_operator_who_is_lost_trips_the_drive_when_the_time_is_over(
    hold_s: float, then: Request | None, ticks: int, *, trips: bool
) -> None:
    desk = by_hand()
    desk.ask(SetVoltage(300.0, hold_s=hold_s))
    assert desk.state() is State.RUNNING  # it does not start anew
    if then is not None:
        desk.pass_ticks(6)
        desk.ask(then, output=3.0)
    desk.pass_ticks(ticks)
    told = "manual: no new voltage within the 0.1 s that its sender had set"
    assert text_of(desk.machine.trip) == (told if trips else None)


def test_a_set_point_that_goes_out_of_reach_stays_as_it_was_asked_for() -> None:
    desk = running(output=4.3)
    desk.machine.reach = Reach(2.0, 4.0)
    assert desk.machine.reference(desk.tick) == 4.3
    desk.ask(SetWaveform(Waveform(Shape.SQUARE, 3.0, 4.0, 60.0)))
    desk.machine.reach = Reach(2.0, 3.5)
    assert desk.machine.obstacle == ""
    desk.machine.forget_reach()
    assert desk.machine.reach == REACH


@pytest.mark.parametrize("runs", [False, True])
def test_a_doubted_stop_must_be_confirmed_again_and_stops_no_drive_that_runs(*, runs: bool) -> None:
    desk = running() if runs else Desk()
    for state, stopped in ((State.STANDBY, True), (State.STOPPING, False), (State.STANDBY, True)):
        (desk.machine.confirm_stop if stopped else desk.machine.withdraw_stop)()
        assert desk.state() is (State.RUNNING if runs else state)
        assert desk.machine.stopped is (stopped and not runs)
    assert (desk.machine.stage is Stage.RUN) is runs


def loaded(**changes: Any) -> MachineLimits:
    return replace(LIMITS, load=LOAD.model_copy(update=changes))


NARROW = Reach(2.25, 4.25)
Check = Callable[[], None]

WITHIN: dict[str, Check] = {
    "lowest set-point": lambda: LIMITS.require_reference("setpoint", 0.0),
    "highest set-point": lambda: LIMITS.require_reference("setpoint", 4.5),
    "lowest in reach": lambda: LIMITS.require_reach("setpoint", 2.25, NARROW),
    "highest in reach": lambda: LIMITS.require_reach("setpoint", 4.25, NARROW),
    "shortest period": lambda: LIMITS.require_period("period_s", 4.0),
    "fastest pole": lambda: LIMITS.require_pole(0.5),
    "slowest pole": lambda: LIMITS.require_pole(0.98),
    "lowest V_c": lambda: LIMITS.require_voltage(200.0, None),
    "highest V_c, for a day": lambda: LIMITS.require_voltage(400.0, 86_400.0),
    "any time": lambda: LIMITS.require_voltage(300.0, 1e-3),
}
BEYOND: dict[str, Check] = {
    "setpoint = -0.1 V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", -0.1),
    "setpoint = 4.6 V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", 4.6),
    "setpoint = nan V is outside 0…4.5 V":
        lambda: LIMITS.require_reference("setpoint", math.nan),
    "setpoint = inf V is outside 0…inf V":
        lambda: loaded(reference_max=math.inf).require_reference("setpoint", math.inf),
    "low = 2.2 V is outside 2.25…4.25 V, which V_c can hold":
        lambda: LIMITS.require_reach("low", 2.2, NARROW),
    "high = 4.3 V is outside 2.25…4.25 V, which V_c can hold":
        lambda: LIMITS.require_reach("high", 4.3, NARROW),
    "period_s = 3.9 s is below 4 s": lambda: LIMITS.require_period("period_s", 3.9),
    "period_s = nan s is below 4 s": lambda: LIMITS.require_period("period_s", math.nan),
    "pole = 0.49 is outside 0.5…0.98": lambda: LIMITS.require_pole(0.49),
    "pole = 0.99 is outside 0.5…0.98": lambda: LIMITS.require_pole(0.99),
    "voltage = 199 V is outside 200…400 V": lambda: LIMITS.require_voltage(199.0, None),
    "voltage = 401 V is outside 200…400 V": lambda: LIMITS.require_voltage(401.0, 1.0),
    "hold_s = 0 s is not above 0 s and at most 86400 s":
        lambda: LIMITS.require_voltage(300.0, 0.0),
    "hold_s = 86400.5 s is not above 0 s": lambda: LIMITS.require_voltage(300.0, 86_400.5),
}  # fmt: skip


@pytest.mark.parametrize("name", WITHIN)
def test_a_value_at_its_limit_is_allowed(name: str) -> None:
    WITHIN[name]()


@pytest.mark.parametrize("reason", BEYOND)
def test_a_value_beyond_its_limit_is_refused_by_name(reason: str) -> None:
    with pytest.raises(RefusedError, match=re.escape(reason)):
        BEYOND[reason]()


@pytest.mark.parametrize(("output", "nearest"), [(-1.0, 0.0), (2.5, 2.5), (9.0, 4.5)])
def test_the_nearest_set_point_is_within_the_limits(output: float, nearest: float) -> None:
    assert LIMITS.nearest_reference(output) == nearest


@pytest.mark.parametrize(("asked_V", "held_V"), [(90.0, 200.0), (250.0, 250.0), (900.0, 400.0)])
def test_a_held_voltage_is_within_its_limits_and_stays(asked_V: float, held_V: float) -> None:
    held = LIMITS.held(asked_V, 7)
    assert [held.value(tick) for tick in (0, 7, 1000)] == [held_V] * 3
    assert held.slew_V == pytest.approx(0.5)  # 60 V/s at 120 Hz
    assert held.find_cause(10**9) is None


def test_an_unknown_voltage_is_held_at_the_floor() -> None:
    assert LIMITS.held(math.nan, 0).value(0) == LIMITS.floor_V


@pytest.mark.parametrize("needs_bridge", [False, True])
def test_a_precharge_that_fails_names_voltage_time_and_remedy(*, needs_bridge: bool) -> None:
    bit = "bridge-and-boost" if needs_bridge else "bridge"
    limits = replace(LIMITS, drive=DRIVE.model_copy(update={"enable_bit": bit}))
    cause = limits.precharge_cause(171.04)
    assert str(cause).startswith("precharge: v_bst = 171.0 V after 5 s, needs 200 V")
    assert ("with its enable bit on" in str(cause)) is needs_bridge
    assert ("drive.enable_bit = 'bridge-and-boost'" in str(cause)) is not needs_bridge


@pytest.mark.parametrize(
    ("name", "one_bit", "state"),
    [
        ("v_bst", False, State.STARTING),
        ("v_bst", True, State.STARTING),
        ("frequency", False, State.RUNNING),
        ("frequency", True, State.STARTING),
    ],
)
def test_only_a_boost_stage_and_what_is_switched_on_are_waited_for(
    name: str, one_bit: bool, state: State
) -> None:
    changes = {
        "enable_bit": "bridge-and-boost" if one_bit else "bridge",
        "manipulated": Manipulated(name=name, unit="Hz"),
    }
    desk = Desk(drive=DRIVE.model_copy(update=changes))
    desk.ask(Enable())
    for tick in range(2):
        desk.machine.advance(tick, 0.0)
    assert desk.machine.state is state


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_voltage_moves_by_its_slope_and_stops_at_its_target(sign: float) -> None:
    moving = ManualVoltage(300.0, 300.0 + 1.5 * sign, since_tick=10, slew_V=0.5)
    way = [sign * (moving.value(tick) - 300.0) for tick in range(8, 16)]
    assert way == [0.0, 0.0, 0.0, 0.5, 1.0, 1.5, 1.5, 1.5]
    short = ManualVoltage(300.0, 300.0 + 0.75 * sign, since_tick=10, slew_V=0.5)
    assert [sign * (short.value(tick) - 300.0) for tick in (11, 12)] == [0.5, 0.75]


def test_a_voltage_with_a_time_expires_after_it() -> None:
    moving = ManualVoltage(300.0, 300.0, since_tick=10, slew_V=0.5, hold_s=0.5, hold_ticks=60)
    assert moving.find_cause(70) is None
    text = "manual: no new voltage within the 0.5 s that its sender had set"
    assert moving.find_cause(71) == Trip(TripKind.OPERATOR_LOST, text)
