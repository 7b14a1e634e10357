"""The state machine: every transition and every refusal."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import pytest

from adaptdrive.config.load import MotorModel, MotorSection
from adaptdrive.config.root import DriveLimits, DriveSection
from adaptdrive.control.signals import UNKNOWN, Mode, Reach, Shape, Stage, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)
from adaptdrive.runtime.settings import FLOOR_REACHED, MachineLimits
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.util.errors import RefusedError
from tests.support import a_trip, text_of

LOAD = MotorSection(
    period_s=1.0,
    pole=0.7,
    output_name="speed",
    output_unit="V",
    type="motor",
    reference_max=4.5,
    model=MotorModel(gain=0.011, tau_motor_s=11.7, tau_filter_s=10.0),
)
DRIVE = DriveSection(name="desk", limits=DriveLimits(manual_slew_V_per_s=60.0))
LIMITS = MachineLimits(
    load=LOAD,
    drive=DRIVE,
    pole_min=0.5,
    pole_max=0.98,
    period_min_s=4.0,
    starting_ticks=600,
    rate_s=5.0,
    reach=Reach(-9.0, 9.0),
)
"""A drive that can hold any set-point."""

REACH = Reach(2.2, 4.4)
SQUARE = Waveform(Shape.SQUARE, 3.0, 3.2, 60.0)
FAULT = "drive fault: word 0x1"


class Desk:
    """A machine at a tick that counts on, with limits of its own."""

    def __init__(self, **limits: Any) -> None:
        self.machine = Machine(replace(LIMITS, **limits))
        self.tick = 100
        self.cause: str | None = None

    def state(self) -> State:
        return self.machine.state

    def ask(self, request: Request, output: float = 2.5) -> None:
        cause = None if self.cause is None else a_trip(self.cause)
        self.machine.carry_out(request, self.tick, output, cause)

    def pass_ticks(self, count: int, boost_voltage_V: float = 210.0) -> None:
        for _ in range(count):
            self.tick += 1
            self.machine.advance(self.tick, boost_voltage_V)

    def refuses(self, request: Request, reason: str) -> None:
        """The request is refused, and nothing was changed."""
        machine = self.machine
        before = attributes(machine)
        with pytest.raises(RefusedError, match=re.escape(reason)):
            self.ask(request)
        assert attributes(machine) == before


def attributes(machine: Machine) -> dict[str, object]:
    """What the machine holds; its limits are values that never change."""
    names = [name for name in dir(machine) if not name.startswith("__") and name != "_limits"]
    held = {name: getattr(machine, name) for name in names}
    return {name: value for name, value in held.items() if not callable(value)}


@pytest.fixture
def standby() -> Desk:
    return Desk()


@pytest.fixture
def starting(standby: Desk) -> Desk:
    standby.ask(Enable())
    return standby


@pytest.fixture
def running(starting: Desk) -> Desk:
    starting.pass_ticks(2)
    assert starting.state() is State.RUNNING
    return starting


@pytest.fixture
def tripped(running: Desk) -> Desk:
    running.machine.latch(a_trip(FAULT))
    return running


def test_it_begins_in_standby_with_everything_off(standby: Desk) -> None:
    machine = standby.machine
    assert (machine.state, machine.mode, machine.trip) == (State.STANDBY, Mode.FIXED, None)
    assert (machine.asked.waveform, machine.pole) == (None, 0.7)
    assert not machine.energised
    assert machine.stage is Stage.OFF


@pytest.mark.parametrize("output", [-0.3, 0.0, 2.1])
def test_enabling_below_what_v_c_can_hold_coasts_until_a_set_point(output: float) -> None:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output=output)
    desk.pass_ticks(5)
    assert (desk.state(), desk.machine.coasting) == (State.RUNNING, True)
    assert (desk.machine.stage, desk.machine.energised) == (Stage.OFF, True)
    assert desk.machine.asked.setpoint == max(output, 0.0)
    assert "coasting" in desk.machine.obstacle
    desk.ask(SetSetpoint(3.0))
    stages = []
    for _ in range(3):
        stages.append(desk.machine.stage)
        desk.pass_ticks(1)
    assert stages == [Stage.OFF, Stage.PRECHARGE, Stage.RUN]
    assert not desk.machine.obstacle


def test_a_set_point_of_0_coasts_and_one_out_of_reach_is_refused() -> None:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output=3.0)
    desk.pass_ticks(2)
    for value in (0.1, 2.19, 4.41):
        desk.refuses(SetSetpoint(value), f"setpoint = {value} V is outside 2.2…4.4 V, which V_c")
    desk.refuses(SetWaveform(Waveform(Shape.SINE, 0.0, 3.0, 60.0)), "waveform low = 0 V is outside")
    desk.ask(SetSetpoint(0.0))
    assert (desk.state(), desk.machine.stage) == (State.RUNNING, Stage.OFF)
    assert desk.machine.commanded_off
    desk.ask(Disable())
    assert (desk.state(), desk.machine.coasting) == (State.STOPPING, False)


@pytest.mark.parametrize("output", [-0.01, 0.0, 0.02])
def test_a_drive_of_unknown_reach_coasts_until_any_set_point_and_at_none(output: float) -> None:
    """The lowest V_c may already charge a battery whose EMF is not known."""
    desk = Desk(reach=UNKNOWN)
    desk.ask(Enable(), output=output)
    assert (desk.machine.stage, desk.machine.coasting) == (Stage.OFF, True)
    desk.ask(SetSetpoint(0.1))
    assert desk.state() is State.STARTING
    assert not desk.machine.obstacle
    desk.pass_ticks(2)
    desk.ask(SetSetpoint(0.0))
    assert (desk.machine.stage, desk.machine.coasting) == (Stage.OFF, True)


def test_a_set_point_in_force_that_goes_out_of_reach_is_named() -> None:
    desk = Desk(reach=REACH)
    desk.ask(Enable(), output=4.3)
    desk.pass_ticks(2)
    desk.machine.reach = Reach(2.0, 4.0)
    assert desk.machine.obstacle == "set-point 4.3 V is outside 2…4 V, which V_c can hold"
    assert desk.machine.stage is Stage.RUN


def test_starting_that_takes_too_long_trips(starting: Desk) -> None:
    starting.pass_ticks(601, boost_voltage_V=171.0)
    assert starting.state() is State.STARTING
    starting.pass_ticks(1, boost_voltage_V=171.0)
    assert starting.state() is State.TRIPPED
    assert starting.machine.trip is not None
    assert str(starting.machine.trip).startswith(
        "precharge: v_bst = 171.0 V after 5 s, needs 200 V"
    )


@pytest.mark.parametrize(
    ("mode", "hold_s", "limit_s"),
    [(Mode.FIXED, 0.5, 5.0), (Mode.MANUAL, 0.5, 0.5), (Mode.MANUAL, None, 5.0)],
)
def test_a_rate_that_stays_unknown_trips(mode: Mode, hold_s: float | None, limit_s: float) -> None:
    desk = Desk()
    desk.ask(SetMode(Mode.MANUAL))
    desk.ask(Enable())
    desk.ask(SetVoltage(300.0, hold_s))
    desk.ask(SetMode(mode))
    for waited_s in (0.0, limit_s, limit_s + 0.25):
        assert desk.state() is State.STARTING
        desk.tick += 1
        desk.machine.advance(desk.tick, 150.0, unknown_rate=a_trip("why"), now_s=64.0 + waited_s)
    cause = f"frame rate: not known {limit_s + 0.25:.3g} s after the start: why"
    assert str(desk.machine.trip) == cause


def test_a_wait_for_the_rate_of_an_earlier_start_does_not_count(starting: Desk) -> None:
    for now_s in (64.0, 128.0):
        starting.machine.advance(starting.tick, 150.0, unknown_rate=a_trip("why"), now_s=now_s)
        starting.ask(Disable())
        starting.machine.confirm_stop()
        starting.ask(Enable())
    assert starting.state() is State.STARTING


def test_a_precharge_that_waited_for_its_rate_may_last_as_long_as_any(starting: Desk) -> None:
    for _ in range(500):
        starting.tick += 1
        now_s = starting.tick * DRIVE.half_cycle_s
        starting.machine.advance(starting.tick, 150.0, unknown_rate=a_trip("why"), now_s=now_s)
    assert starting.machine.stage is Stage.OFF
    starting.pass_ticks(601, boost_voltage_V=171.0)
    assert (starting.state(), starting.machine.stage) == (State.STARTING, Stage.PRECHARGE)


@pytest.mark.parametrize("name", ["starting", "running"])
def test_disabling_stops_until_the_drive_confirms(
    request: pytest.FixtureRequest, name: str
) -> None:
    desk: Desk = request.getfixturevalue(name)
    desk.ask(SetWaveform(SQUARE))
    desk.ask(Disable())
    assert desk.state() is State.STOPPING
    assert (desk.machine.stage, desk.machine.energised) == (Stage.OFF, False)
    assert desk.machine.asked.waveform is None
    desk.refuses(Enable(), "the drive has not confirmed its stop; enable it in standby")
    desk.cause = FAULT
    desk.refuses(Enable(), f"the drive has not confirmed its stop ({FAULT}); enable it in standby")
    desk.cause = None
    desk.machine.confirm_stop()
    assert desk.state() is State.STANDBY


def test_only_reset_leaves_a_trip(tripped: Desk) -> None:
    tripped.refuses(Enable(), f"tripped ({FAULT}); reset first")
    tripped.ask(Disable())
    tripped.ask(SetMode(Mode.ADAPTIVE))
    tripped.pass_ticks(1000, boost_voltage_V=300.0)
    assert tripped.state() is State.TRIPPED
    tripped.machine.confirm_stop()
    assert tripped.state() is State.TRIPPED
    tripped.ask(Reset())
    assert (tripped.state(), tripped.machine.trip) == (State.STANDBY, None)


def test_reset_is_refused_while_the_cause_is_there(tripped: Desk) -> None:
    tripped.cause = FAULT
    tripped.refuses(Reset(), f"cause is still there: {FAULT}")


def test_after_a_reset_the_drive_stays_off_until_it_is_enabled(tripped: Desk) -> None:
    tripped.machine.confirm_stop()
    tripped.ask(Reset())
    tripped.pass_ticks(1000, boost_voltage_V=300.0)
    assert tripped.state() is State.STANDBY
    tripped.ask(Enable())
    tripped.pass_ticks(2)
    assert tripped.state() is State.RUNNING


def test_a_set_point_is_steady_while_no_waveform_and_no_operator_moves_the_output(
    running: Desk,
) -> None:
    assert running.machine.steady is True
    running.ask(SetWaveform(SQUARE))
    assert running.machine.steady is False
    running.ask(SetMode(Mode.MANUAL))
    assert running.machine.asked.waveform is None
    assert running.machine.steady is False
    running.ask(SetMode(Mode.ADAPTIVE))
    assert running.machine.steady is True


@pytest.mark.parametrize(
    ("reach", "output", "held"),
    [
        (LIMITS.reach, 2.75, 2.75),
        (LIMITS.reach, 7.0, 4.5),
        (REACH, 2.2, 2.2),
        (REACH, 5.0, 4.5),
    ],
)
def test_enabling_starts_and_holds_the_present_output_or_the_nearest_that_is_allowed(
    reach: Reach, output: float, held: float
) -> None:
    """It lasts a tick at least, so that a controller which ran until a moment ago begins anew."""
    desk = Desk(reach=reach)
    desk.cause = "stale: no measurement yet"
    desk.refuses(Enable(), "stale: no measurement yet")
    desk.cause = None
    desk.ask(Enable(), output)
    stages = [desk.machine.stage]
    desk.tick += 10
    for _ in range(2):
        assert desk.state() is State.STARTING
        desk.pass_ticks(1, boost_voltage_V=300.0)
        stages.append(desk.machine.stage)
    assert stages == [Stage.OFF, Stage.PRECHARGE, Stage.RUN]
    assert desk.state() is State.RUNNING
    assert desk.machine.reference(desk.tick) == held


@pytest.mark.parametrize(
    ("voltage_V", "state"),
    [
        (FLOOR_REACHED * LIMITS.floor_V, State.RUNNING),
        (math.nextafter(FLOOR_REACHED * LIMITS.floor_V, 0.0), State.STARTING),
    ],
)
def test_it_runs_from_the_floor_on(starting: Desk, voltage_V: float, state: State) -> None:
    starting.pass_ticks(100, boost_voltage_V=190.0)
    assert starting.state() is State.STARTING
    starting.pass_ticks(2, boost_voltage_V=voltage_V)
    assert starting.state() is state


@pytest.mark.parametrize("name", ["standby", "starting", "running"])
def test_any_state_takes_mode_pole_and_a_trip(request: pytest.FixtureRequest, name: str) -> None:
    desk: Desk = request.getfixturevalue(name)
    before = desk.state()
    for wish in (SetMode(Mode.ADAPTIVE), SetPole(0.9), Reset()):
        desk.ask(wish)
    assert (desk.machine.mode, desk.machine.pole) == (Mode.ADAPTIVE, 0.9)
    assert desk.state() is before
    desk.machine.latch(a_trip(FAULT))
    desk.machine.latch(a_trip("over-voltage"))
    assert (desk.state(), text_of(desk.machine.trip)) == (State.TRIPPED, FAULT)
    assert (desk.machine.stage, desk.machine.energised) == (Stage.OFF, False)
    desk.ask(SetMode(Mode.FIXED))
    assert desk.machine.mode is Mode.FIXED


@pytest.mark.parametrize("name", ["standby", "tripped"])
def test_a_set_point_needs_an_enabled_drive(request: pytest.FixtureRequest, name: str) -> None:
    desk: Desk = request.getfixturevalue(name)
    for wish in (SetSetpoint(3.0), SetWaveform(SQUARE), SetWaveform(None)):
        desk.refuses(wish, f"needs an enabled drive; state is {desk.state()}")


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (SetSetpoint(4.501), "setpoint = 4.501 V is outside 0…4.5 V"),
        (SetWaveform(Waveform(Shape.SINE, -0.1, 3.0, 60.0)), "waveform low = -0.1 V is outside"),
        (SetWaveform(Waveform(Shape.SINE, 3.0, 4.5000001, 60.0)),
         "waveform high = 4.5000001 V is outside 0…4.5 V"),
        (SetWaveform(Waveform(Shape.SINE, 3.0, 3.2, 3.9)), "period_s = 3.9 s is below 4 s"),
        (SetPole(0.99), "is outside 0.5…0.98"),
    ],
)  # fmt: skip
def test_a_request_out_of_range_is_refused(running: Desk, request_: Request, reason: str) -> None:
    running.refuses(request_, reason)


def test_a_waveform_begins_when_it_is_asked_for_and_ends_where_it_is(running: Desk) -> None:
    running.pass_ticks(1000)
    running.ask(SetWaveform(SQUARE))
    start, half = running.tick, 30 * 120
    values = [running.machine.reference(start + ticks) for ticks in (0, half - 1, half, 2 * half)]
    assert values == [3.2, 3.2, 3.0, 3.2]
    running.ask(Enable(), output=1.0)  # it is enabled
    assert running.machine.asked.waveform is SQUARE
    running.ask(SetWaveform(Waveform(Shape.TRIANGLE, 2.0, 4.0, 8.0)))
    running.pass_ticks(120)
    held = running.machine.reference(running.tick)
    running.ask(SetWaveform(None))
    assert running.machine.reference(running.tick + 5000) == held
    running.ask(SetWaveform(SQUARE))
    running.ask(SetSetpoint(-0.0))
    assert running.machine.asked.waveform is None
    assert math.copysign(1.0, running.machine.reference(running.tick + 99_999)) == 1.0


@pytest.mark.parametrize("trips", [False, True])
def test_enabling_forgets_set_point_and_waveform_of_the_last_run(
    running: Desk, *, trips: bool
) -> None:
    running.ask(SetWaveform(SQUARE))
    if trips:
        running.machine.latch(a_trip(FAULT))
        running.ask(Reset())
        assert running.state() is State.STOPPING
    running.ask(Disable())
    running.machine.confirm_stop()
    assert running.state() is State.STANDBY
    running.ask(Enable(), output=1.25)
    assert running.machine.asked.waveform is None
    assert running.machine.reference(running.tick + 5000) == 1.25
