"""A program: its steps one after another, what turns it, and what ends it where it is."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.app.settings import machine_limits
from adaptdrive.cli.programs import read_program
from adaptdrive.config import load_configuration
from adaptdrive.control.signals import Mode, Reach, Shape, Waveform
from adaptdrive.runtime.program import Programs
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import (
    Choose,
    Disable,
    Enable,
    End,
    HoldFor,
    Program,
    RampTo,
    Request,
    Reset,
    RunProgram,
    SetMode,
    SetPole,
    SetSetpoint,
    SetWaveform,
    Step,
    Turn,
    WaveFor,
)
from adaptdrive.util.errors import RefusedError
from tests.support import a_trip
from tests.unit.runtime.test_machine import DRIVE, LIMITS, REACH, SQUARE, Desk

DEPLOY = Path(__file__).parents[3] / "deploy"
TICK_S = DRIVE.half_cycle_s
SINE = WaveFor(Shape.SINE, 3.0, 3.2, 8.0, 4.0)
CYCLE = (RampTo(3.5, 1.0), HoldFor(0.5), SINE, RampTo(2.0, 2.0))


class Bench(Desk):
    """A running drive whose output follows its reference at once, and its program."""

    def __init__(self, **limits: object) -> None:
        super().__init__(**limits)
        self.programs = Programs(self.machine, self.machine._limits)
        self.off = 0.0
        self.ask(Enable())
        self.pass_ticks(2)

    def turn(self, value: Program | Turn) -> None:
        output = self.machine.reference(self.tick)
        self.programs.carry_out(RunProgram(value), self.tick, output)

    def start(self, *steps: Step, end: End = End.HOLD) -> None:
        self.turn(Program("cycle", steps, end))

    def by_hand(self, request: Request) -> None:
        self.programs.refuse_by_hand(request)
        self.ask(request)

    def live(self, ticks: int, stride: int = 1) -> Iterator[float]:
        """The reference at each tick, and what the daemon does between two."""
        for _ in range(ticks):
            self.pass_ticks(1)
            self.tick += stride - 1
            reference = self.machine.order(self.tick).reference
            yield reference
            self.machine.progress(self.tick)
            self.programs.progress(self.tick, reference + self.off)

    def stays(self, time_s: float) -> float:
        """The one reference of that time."""
        (reference,) = set(self.live(seconds(time_s)))
        return reference

    def status(self) -> tuple[int, str, str]:
        report = self.programs.report
        assert report is not None
        return report.step, report.status, report.reason

    def refuses_program(self, value: Program | Turn, reason: str) -> None:
        with pytest.raises(RefusedError, match=re.escape(reason)):
            self.turn(value)


def seconds(time_s: float) -> int:
    return round(time_s / TICK_S)


def test_its_steps_are_the_course_that_it_states() -> None:
    bench = Bench()
    bench.start(*CYCLE)
    found = np.array([*bench.live(seconds(7.0))])
    time_s = TICK_S * np.arange(1, len(found) + 1)
    wave = Waveform(Shape.SINE, 3.0, 3.2, 8.0)
    last = wave.value(4.0)
    expected = np.interp(time_s, [0.0, 1.0, 1.5], [2.5, 3.5, 3.5])
    during = (time_s > 1.5) & (time_s <= 5.5 + 0.1 * TICK_S)
    expected[during] = [wave.value(one - 1.5) for one in time_s[during]]
    after = time_s > 5.5 + 0.1 * TICK_S
    expected[after] = np.maximum(2.0, last - 2.0 * (time_s[after] - 5.5))
    largest = 2.0 * 2.0 * TICK_S  # one tick each at the end of a step
    assert np.abs(found - expected).max() < largest
    assert found[-1] == 2.0
    assert bench.status() == (4, "ended", "complete")


@given(st.integers(1, 700), st.integers(1, 300))
def test_a_pause_holds_the_reference_and_changes_nothing_that_follows(at: int, ticks: int) -> None:
    straight, paused = Bench(), Bench()
    straight.start(*CYCLE)
    paused.start(*CYCLE)
    before = [*paused.live(at)]
    paused.turn(Turn.PAUSE)
    assert paused.status()[1:] == ("paused", "")
    left = paused.programs.remaining_s(paused.tick)
    assert set(paused.live(ticks)) == {before[-1]}
    assert paused.programs.remaining_s(paused.tick) == pytest.approx(left)
    paused.turn(Turn.RESUME)
    after = [*paused.live(800 - at)]
    assert before + after == pytest.approx([*straight.live(800)], abs=1e-9)
    assert paused.status() == straight.status()


@given(
    st.lists(
        st.builds(RampTo, st.floats(2.3, 4.3), st.floats(0.2, 5.0))
        | st.builds(HoldFor, st.floats(0.01, 3.0))
        | st.builds(Choose, st.sampled_from(["fixed", "adaptive"])),
        min_size=1,
        max_size=5,
    )
)
def test_what_it_says_is_left_is_what_it_takes(steps: list[Step]) -> None:
    bench = Bench()
    bench.start(*steps)
    left_s = bench.programs.remaining_s(bench.tick)
    assert left_s is not None
    ticks = 0
    while bench.status()[1] == "running":
        ticks += 1
        [*bench.live(1)]
    assert ticks * TICK_S == pytest.approx(left_s, abs=(2 * len(steps) + 1) * TICK_S)
    assert bench.programs.remaining_s(bench.tick) is None


def test_it_waits_until_the_output_has_been_near_for_long_enough() -> None:
    bench = Bench()
    bench.start(RampTo(3.0), HoldFor(0.5, 0.1))
    bench.off = 0.2
    [*bench.live(seconds(5.0))]
    assert bench.status() == (2, "running", "")
    bench.off = -0.05
    [*bench.live(seconds(0.4))]
    bench.off = -0.2
    [*bench.live(1)]
    bench.off = 0.05
    [*bench.live(seconds(0.5) - 1)]
    assert bench.status() == (2, "running", "")
    [*bench.live(1)]
    assert bench.status() == (2, "ended", "complete")


def test_a_skipped_step_leaves_the_reference_where_it_is() -> None:
    bench = Bench()
    bench.start(RampTo(3.5, 1.0), HoldFor(10.0), RampTo(2.5, 1.0))
    [*bench.live(seconds(0.5))]
    bench.turn(Turn.SKIP)
    assert bench.status()[:2] == (2, "running")
    assert bench.stays(2.0) == pytest.approx(3.0)
    bench.turn(Turn.PAUSE)
    bench.turn(Turn.SKIP)
    assert [*bench.live(seconds(0.25))][-1] == pytest.approx(2.75)
    bench.turn(Turn.STOP)
    assert bench.stays(1.0) == pytest.approx(2.75)
    assert bench.status() == (3, "ended", "stopped")


@pytest.mark.parametrize(
    ("end", "state", "coasting"),
    [
        (End.HOLD, State.RUNNING, False),
        (End.REST, State.RUNNING, True),
        (End.DISABLE, State.STOPPING, False),
    ],
)
def test_its_end_is_the_one_that_it_states(end: End, state: State, coasting: bool) -> None:
    bench = Bench()
    bench.start(RampTo(3.0), HoldFor(0.1), end=end)
    [*bench.live(seconds(0.2))]
    assert bench.status() == (2, "ended", "complete")
    assert (bench.state(), bench.machine.coasting) == (state, coasting)


@pytest.mark.parametrize(("cause", "reason"), [(True, "tripped"), (False, "disabled")])
@pytest.mark.parametrize("paused", [False, True])
def test_a_drive_that_is_off_has_ended_it_and_nothing_resumes(
    cause: bool, reason: str, paused: bool
) -> None:
    bench = Bench()
    bench.start(RampTo(3.5, 1.0), HoldFor(10.0))
    [*bench.live(seconds(0.5))]
    if paused:
        bench.turn(Turn.PAUSE)
    if cause:
        bench.machine.latch(a_trip("stale: x"))
    else:
        bench.ask(Disable())
    assert bench.status() == (1, "ended", reason)
    bench.machine.confirm_stop()
    bench.ask(Reset())
    bench.ask(Enable(), output=2.6)
    assert bench.stays(2.0) == 2.6
    assert bench.status() == (1, "ended", reason)
    bench.refuses_program(Turn.RESUME, "no program runs")


@pytest.mark.parametrize("paused", [False, True])
def test_by_hand_nothing_moves_what_a_program_moves(paused: bool) -> None:
    bench = Bench()
    bench.start(HoldFor(10.0))
    if paused:
        bench.turn(Turn.PAUSE)
    requests: list[Request] = [
        SetSetpoint(3.0),
        SetWaveform(SQUARE),
        SetWaveform(None),
        SetMode(Mode.MANUAL),
    ]
    for request in requests:
        with pytest.raises(RefusedError, match=r"program 'cycle' is .*: stop it before"):
            bench.by_hand(request)
    bench.by_hand(SetPole(0.8))
    bench.refuses_program(Program("other", (HoldFor(1.0),)), "program 'cycle' is")
    bench.turn(Turn.STOP)
    bench.by_hand(SetSetpoint(3.0))


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (RampTo(9.0), "ramp to = 9 V is outside 0…4.5 V"),
        (RampTo(1.0), "ramp to = 1 V is outside 2.2…4.4 V, which V_c can hold"),
        (RampTo(3.0, -2.0), "slope = -2 is not a finite number above 0"),
        (RampTo(3.0, 5e-324), "slope = 4.94065645841e-324 is outside 1e-09…1e+09"),
        (HoldFor(math.inf), "for_s = inf is not a finite number above 0"),
        (HoldFor(1e307), "for_s = 1e+307 is outside 1e-09…1e+09"),
        (HoldFor(math.nan), "for_s = nan is not a finite number above 0"),
        (WaveFor(Shape.SINE, 3.0, 4.0, math.inf, 5.0), "waveform period_s = inf is not a finite"),
        (HoldFor(1.0, 0.0), "within = 0 is not a finite number above 0"),
        (
            WaveFor(Shape.SQUARE, 3.0, 4.45, 1.0, 5.0),
            "waveform high = 4.45 V is outside 2.2…4.4 V, which V_c can hold",
        ),
    ],
)
def test_a_step_that_cannot_be_carried_out_is_named_before_it_starts(
    step: Step, reason: str
) -> None:
    bench = Bench(reach=REACH)
    bench.refuses_program(Program("wrong", (RampTo(0.0), step)), f"step 2: {reason}")
    assert bench.programs.report is None


def test_it_needs_an_enabled_drive() -> None:
    desk = Desk()
    programs = Programs(desk.machine, LIMITS)
    with pytest.raises(RefusedError, match="program needs an enabled drive; state is standby"):
        programs.carry_out(RunProgram(Program("cycle", CYCLE)), 100, 2.5)
    assert programs.report is None


def test_a_step_that_v_c_cannot_hold_any_more_ends_it_where_it_is() -> None:
    bench = Bench()
    bench.start(RampTo(3.0), HoldFor(0.1), RampTo(4.0))
    bench.machine.reach = Reach(2.2, 3.5)
    assert [*bench.live(seconds(1.0))][-1] == 3.0
    step, status, reason = bench.status()
    assert (step, status) == (3, "ended")
    assert reason == "setpoint = 4 V is outside 2.2…3.5 V, which V_c can hold"


@pytest.mark.parametrize("name", ["bath", "motor"])
def test_the_examples_are_programs_of_their_drives(name: str) -> None:
    program = msgspec.convert(read_program(DEPLOY / "programs" / f"{name}.toml"), Program)
    limits = machine_limits(load_configuration(DEPLOY / "examples" / f"{name}.toml"))
    bench = Bench(**{field: getattr(limits, field) for field in ("load", "reach", "drive")})
    bench.ask(SetSetpoint(limits.reach.nearest(limits.load.reference_min)))
    bench.pass_ticks(2)
    bench.turn(program)
    left_s = bench.programs.remaining_s(bench.tick)
    assert left_s is not None
    for _ in range(math.ceil(left_s / (12 * TICK_S)) + 60):
        [*bench.live(1, stride=12)]
    assert bench.status() == (len(program.steps), "ended", "complete")
