"""Whatever is asked in whatever order: nothing energises but `enable`, nothing escapes a trip.

And nothing but the drive's own word ends a stop.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from adaptdrive.control.signals import Mode, Shape, Stage, Waveform
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
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.trips import Trip
from adaptdrive.util.errors import RefusedError
from tests.support import a_trip
from tests.unit.runtime.test_machine import LIMITS as PLAIN
from tests.unit.runtime.test_machine import LOAD, REACH

LIMITS = replace(PLAIN, reach=REACH)

ANY = st.floats() | st.floats(-1.0, 6.0)
WAVEFORMS = st.builds(Waveform, st.sampled_from(Shape), ANY, ANY, ANY | st.floats(4.0, 100.0))
WISHES = st.one_of(
    st.builds(SetSetpoint, ANY, st.none() | ANY),
    st.builds(SetWaveform, st.none() | WAVEFORMS),
    st.builds(SetMode, st.sampled_from(Mode)),
    st.builds(SetVoltage, st.floats() | st.floats(200.0, 400.0), st.none() | ANY),
    st.builds(SetPole, ANY),
)
CAUSES = st.none() | st.sampled_from([a_trip("stale: x"), a_trip("drive fault: x")])
ROUNDING = 1e-9


class AnyOperator(RuleBasedStateMachine):
    """Asks anything at any time."""

    def __init__(self) -> None:
        super().__init__()
        self.machine = Machine(LIMITS)
        self.tick = 0
        self.allowed = False
        self.trip: Trip | None = None
        self.stopped = True

    def ask(self, request: Request, cause: Trip | None, output: float = 2.0) -> bool:
        with contextlib.suppress(RefusedError):
            self.machine.carry_out(request, self.tick, output, cause)
            return True
        return False

    @rule(ticks=st.integers(1, 700), boost_voltage_V=st.floats(0.0, 450.0))
    def pass_time(self, ticks: int, boost_voltage_V: float) -> None:
        was_starting = self.machine.state is State.STARTING
        self.tick += ticks
        self.machine.advance(self.tick, boost_voltage_V)
        if was_starting and self.machine.state is State.TRIPPED:
            self.note_trip()

    @rule(cause=CAUSES, output=st.floats(-10.0, 10.0))
    def enable(self, cause: Trip | None, output: float) -> None:
        was_energised, was_stopping = self.machine.energised, self.machine.state is State.STOPPING
        accepted = self.ask(Enable(), cause, output)
        assert accepted == (
            self.trip is None and not was_stopping and (was_energised or cause is None)
        )
        self.allowed |= accepted
        self.stopped &= not accepted

    @rule(cause=CAUSES)
    def disable(self, cause: Trip | None) -> None:
        assert self.ask(Disable(), cause)
        self.allowed = False

    @rule(cause=CAUSES)
    def reset(self, cause: Trip | None) -> None:
        accepted = self.ask(Reset(), cause)
        assert accepted == (self.trip is None or cause is None)
        if accepted:
            self.trip = None

    @rule(cause=st.text(min_size=1, max_size=5))
    def latch(self, cause: str) -> None:
        self.machine.latch(a_trip(cause))
        self.note_trip()

    @rule()
    def confirm_stop(self) -> None:
        self.machine.confirm_stop()
        self.stopped |= not self.machine.energised

    @rule()
    def withdraw_stop(self) -> None:
        self.machine.withdraw_stop()
        self.stopped = False

    @rule(wish=WISHES, cause=CAUSES)
    def wish(self, wish: Request, cause: Trip | None) -> None:
        before, enabled = self.machine.state, self.machine.energised
        self.ask(wish, cause)
        assert self.machine.energised == enabled
        assert self.machine.state is before or enabled

    def note_trip(self) -> None:
        self.trip = self.trip or self.machine.trip
        self.allowed = False

    @invariant()
    def nothing_is_energised_unless_enabled(self) -> None:
        assert self.machine.energised <= self.allowed
        assert self.machine.stage is Stage.OFF or self.machine.energised
        controlled = self.machine.state is State.RUNNING and not self.machine.coasting
        assert (self.machine.stage is Stage.RUN) == controlled

    @invariant()
    def a_trip_stays_with_its_first_cause(self) -> None:
        assert (self.machine.state is State.TRIPPED) == (self.trip is not None)
        assert self.machine.trip == self.trip

    @invariant()
    def only_a_confirmed_stop_is_standby(self) -> None:
        assert self.machine.state is not State.STANDBY or self.stopped

    @invariant()
    def what_is_controlled_is_within_reach(self) -> None:
        if self.machine.stage is Stage.RUN and self.machine.mode is not Mode.MANUAL:
            for ahead in (0, 1, 777, 100_003):
                value = self.machine.reference(self.tick + ahead)
                assert REACH.low - ROUNDING <= value <= LOAD.reference_max + ROUNDING

    @invariant()
    def limits_hold(self) -> None:
        low, high = LOAD.reference_min - ROUNDING, LOAD.reference_max + ROUNDING
        for ahead in (0, 1, 777, 100_003):
            assert low <= self.machine.reference(self.tick + ahead) <= high
        assert LIMITS.pole_min <= self.machine.pole <= LIMITS.pole_max


TestAnyOperator = AnyOperator.TestCase
TestAnyOperator.settings = settings(stateful_step_count=30)
