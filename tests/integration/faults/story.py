"""Stories of one drive and its daemon, drawn by hypothesis: operators, faults, freezes, restarts.

Whatever happens in whatever order, no command energises a drive that must be off (`off.py`). A
story that fails is shrunk to the shortest list of steps that still does.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from adaptdrive.config.file import validate_configuration
from adaptdrive.config.root import Configuration
from adaptdrive.control.signals import Command, Decision, Mode, Shape, Waveform
from adaptdrive.runtime.reports import LoadReport
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
from adaptdrive.safety.facts import Reading
from tests.integration.faults.by_hand import DaemonByHand
from tests.integration.faults.off import MustBeOff, OWN_TIMEOUT_s
from tests.integration.wire.rig import EXAMPLES
from tests.support import a_trip

MOTOR = EXAMPLES / "motor.toml"
TICK_s = 1.0 / 120.0
OTHER_SENDER = a_trip("another sender commands")
HEALTHY = {"boost_voltage_V": 215.0, "output": 2.6, "fault": 0, "line_voltage_V": 120.0}
WISHES = st.one_of(
    st.builds(SetSetpoint, st.sampled_from([0.0, 2.5, 3.3, 4.2, 9.0, math.nan])),
    st.builds(SetMode, st.sampled_from(Mode)),
    st.builds(SetVoltage, st.sampled_from([200.0, 300.0, 400.0]), st.sampled_from([None, 0.5])),
    st.builds(SetPole, st.sampled_from([0.6, 0.9])),
    st.just(SetWaveform(Waveform(Shape.SQUARE, 2.5, 3.5, 20.0))),
    st.just(SetWaveform(None)),
)
FAULTS = [
    {"fault": 2},
    {"boost_voltage_V": 431.0},
    {"output": 5.1},
    {"output": math.nan},
    {"line_voltage_V": math.inf},
    {"boost_voltage_V": 150.0},
]


def motor(stale_s: float, own_timeout_s: float, start_s: float) -> Configuration:
    """The example of a motor: how old its measurements may be, when its drive stops and starts."""
    tables = tomllib.loads(MOTOR.read_text())
    tables["interlocks"]["stale_s"] = stale_s
    tables["interlocks"]["start_s"] = start_s
    tables["bus"]["command_timeout_s"] = own_timeout_s
    return validate_configuration(tables, MOTOR)


class Story(RuleBasedStateMachine):
    """One drive, one daemon at a time, and all that may happen to them.

    Attributes:
        stale_s: `interlocks.stale_s` of the daemon.
        own_timeout_s: The drive's own time-out, as the configuration states it.
        start_s: `interlocks.start_s` of the daemon.
        start_ticks: Half cycles that the drive takes to switch its bridge on.
    """

    stale_s = 0.05
    own_timeout_s = OWN_TIMEOUT_s
    start_s = 30 * TICK_s
    start_ticks = 0

    def __init__(self) -> None:
        super().__init__()
        self.now = 1000.0
        self.must = MustBeOff(self.stale_s, self.own_timeout_s, self.start_s)
        self.configuration = motor(self.stale_s, self.own_timeout_s, self.start_s)
        self.values = dict(HEALTHY)
        self.counter = 0
        self.bridge = False
        self.obeys = self.plugged = True
        self.commanded_s, self.on_since_s = -math.inf, math.inf
        self.tripped = self.load_gone = False
        self.daemon = self._start_daemon()

    @initialize(readings=st.sampled_from([62, 62, 62, 3]))
    def wake_up(self, readings: int) -> None:
        self.pass_ticks(readings)

    # -- time --------------------------------------------------------------------------------

    @rule(ticks=st.sampled_from([1, 2, 7, 40, 130]))
    def pass_ticks(self, ticks: int) -> None:
        for _ in range(ticks):
            self.daemon.wait(self.now + TICK_s)
            self._half_cycle(deliver=True)

    @rule(ticks=st.integers(1, 20))
    def lose_frames(self, ticks: int) -> None:
        for _ in range(ticks):
            self.daemon.wait(self.now + TICK_s)
            self.must.note_run(self.daemon.ran_s)  # it may keep its commands back meanwhile
            self._half_cycle(deliver=False)

    @rule(ticks=st.sampled_from([3, 8, 15, 30, 50]))
    def pull_the_cable_for_a_while(self, ticks: int) -> None:
        self.plugged = False
        self.lose_frames(ticks)
        self.plugged = True

    @rule(ticks=st.sampled_from([3, 8, 15, 60, 600]), reads_first=st.booleans())
    def freeze_and_thaw(self, ticks: int, reads_first: bool) -> None:
        for _ in range(ticks):
            self._half_cycle(deliver=False, keep=True)
        self.daemon.sleep(self.now)
        if reads_first:
            self.daemon.port.catch_up()
        self.daemon.wait(self.now)
        self.daemon.port.catch_up()

    @rule(ticks=st.sampled_from([3, 8, 20, 60]))
    def freeze_within_a_tick(self, ticks: int) -> None:
        schedule = self.daemon.fast._schedule
        tick = schedule._controller.tick

        def frozen(*words: object) -> Command:
            command: Command = tick(*words)  # type: ignore[arg-type]
            for _ in range(ticks):
                self._half_cycle(deliver=False, keep=True)
            self.daemon.sleep(self.now)
            return command

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(schedule._controller, "tick", frozen)
            self._half_cycle(deliver=True)
        self.daemon.port.catch_up()

    @rule(line_Hz=st.sampled_from([40.0, 50.0, 75.0]))
    def change_line(self, line_Hz: float) -> None:
        for _ in range(int(6.0 * line_Hz)):
            self.daemon.wait(self.now + 0.5 / line_Hz)
            self._half_cycle(deliver=True, lasts_s=0.5 / line_Hz)
        self.must.revoke("its frames came at another rate for three seconds")

    # -- the drive and its bus ---------------------------------------------------------------

    @rule(fault=st.sampled_from(FAULTS))
    def break_down(self, fault: dict[str, float]) -> None:
        self.values |= fault

    @rule()
    def mend(self) -> None:
        self.values, self.obeys = dict(HEALTHY), True

    @rule(on=st.booleans())
    def bridge_sticks(self, on: bool) -> None:
        self.bridge, self.obeys = on, False

    @rule()
    def restart_drive(self) -> None:
        self.counter, self.obeys = 0, True
        self._obey(on=False)

    @rule()
    def lose_bus(self) -> None:
        self.daemon.port.lose()

    @precondition(lambda self: not self.daemon.port.up)
    @rule()
    def restore_bus(self) -> None:
        self.daemon.port.restore()

    @rule(speaks=st.booleans())
    def another_sender(self, speaks: bool) -> None:
        self.must.trip_cause = speaks
        self.daemon.port.trip_cause = OTHER_SENDER if speaks else None

    # -- the daemon --------------------------------------------------------------------------

    @rule()
    def restart_daemon(self) -> None:
        self.must.restart()
        self.tripped = False
        self.daemon = self._start_daemon()

    @rule(stalls=st.booleans())
    def stall_slow_loop(self, stalls: bool) -> None:
        self.must.stalled = stalls

    @rule(gone=st.booleans())
    def lose_load(self, gone: bool) -> None:
        """Have the slow loop decide that the drive must stop."""
        self.load_gone = gone

    def _start_daemon(self) -> DaemonByHand:
        daemon = DaemonByHand(self.configuration, self._hear, self.now)
        daemon.port.trip_cause = OTHER_SENDER if self.must.trip_cause else None
        daemon.port.on_delivery = self._note
        daemon.revise = self._revised
        return daemon

    def _revised(self, decision: Decision) -> Decision:
        if not self.load_gone:
            return decision
        return replace(decision, fault="the load is gone", fault_kind="no-response")

    # -- operators ---------------------------------------------------------------------------

    @rule()
    def enable(self) -> None:
        if self.daemon.accepts(Enable()):
            assert not self.tripped, "enabled without a reset"
            self.must.enable(self.now)

    @rule()
    def disable(self) -> None:
        self.must.revoke("it was disabled")
        self.daemon.accepts(Disable())

    @rule()
    def reset(self) -> None:
        if self.daemon.accepts(Reset()) and self.tripped:
            cause = self.must.cause(self.now)
            assert cause is None, f"reset although {cause}"
            self.tripped = False

    @rule(wish=WISHES)
    def ask(self, wish: Request) -> None:
        self.daemon.accepts(wish)

    @rule()
    def bring_up(self) -> None:
        """All that an operator does to run a healthy drive."""
        self.mend()
        self.another_sender(speaks=False)
        if not self.daemon.port.up:
            self.restore_bus()
        self.stall_slow_loop(stalls=False)
        self.lose_load(gone=False)
        self.pass_ticks(130)
        self.reset()
        self.enable()
        self.daemon.accepts(SetSetpoint(3.3))
        self.pass_ticks(5)

    @invariant()
    def it_has_not_died(self) -> None:
        failure = self.daemon.trip or ""
        assert not failure.startswith("internal error"), failure

    # -- the bus as the daemon and the model see it ------------------------------------------

    def _hear(self, command: Command) -> None:
        if not self.plugged:
            self.must.ran_s = self.daemon.now
            return
        self.must.judge(command, self.daemon.now)
        self.commanded_s = self.daemon.now
        if self.obeys:
            self._obey(on=command.bridge and not self.values["fault"])

    def _obey(self, *, on: bool) -> None:
        """Switch the bridge off at once, and on once that was commanded for long enough."""
        self.on_since_s = min(self.on_since_s, self.now) if on else math.inf
        self.bridge = on and self.now - self.on_since_s > (self.start_ticks - 0.5) * TICK_s

    def _note(self, reading: Reading) -> None:
        self.must.reading, self.must.readings = reading, self.must.readings + 1

    def _half_cycle(self, *, deliver: bool, keep: bool = False, lasts_s: float = TICK_s) -> None:
        """The drive lives for half a cycle and sends; it is heard, kept for later, or lost."""
        self.now += lasts_s
        self.counter += 1
        if self.now - self.commanded_s > self.own_timeout_s and self.obeys:
            self._obey(on=False)
        reading = self._reading()
        if keep and self.daemon.port.up:
            self.daemon.port.waiting.append(reading)
        elif deliver:
            self.daemon.sleep(self.now)
            self.daemon.port.deliver(reading)
        if not keep and not self.must.stalled:
            self._decide()
        if self.daemon.trip is not None:
            self.tripped = True
            self.must.revoke("it has tripped")

    def _reading(self) -> Reading:
        return Reading(
            arrival_s=self.now,
            oldest_s=self.now,
            counter=self.counter % 65536,
            load_power_W=300.0,
            bridge=self.bridge,
            boost_voltage_V=self.values["boost_voltage_V"],
            line_voltage_V=self.values["line_voltage_V"],
            output=self.values["output"],
            fault=int(self.values["fault"]),
        )

    def _decide(self) -> None:
        self.daemon.decide()
        for report in self.daemon.heard():
            if isinstance(report, LoadReport) and report.decision.fault:
                self.must.revoke("a decision had it stopped")


class PatientStory(Story):
    """A daemon that drives on through a silence in which the drive stops by itself."""

    stale_s = 0.45


class HastyDriveStory(PatientStory):
    """The same with a drive that stops by itself sooner than one of an unknown time-out may."""

    own_timeout_s = 0.05


class SlowDriveStory(PatientStory):
    """The same with a drive that takes 60 half cycles to switch on, and a daemon that knows it."""

    start_s = 0.6
    start_ticks = 60
