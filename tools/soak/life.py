"""The life of one drive in virtual time: operators, faults that come and go, restarts.

A model of its own (`MustBeOff`) judges each command that reaches the bus.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from adaptdrive.control.signals import Command, Mode, Shape, Waveform
from adaptdrive.runtime.reports import LoadReport, State
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
from adaptdrive_sim.plants.motor import Motor
from tests.integration.faults.by_hand import DaemonByHand
from tests.integration.faults.course import Course, honest
from tests.integration.faults.off import MustBeOff
from tests.integration.faults.rows import ROWS, Row
from tools.soak.tape import Tape
from tools.soak.verdict import Judged

NAME = "motor, CAN"
FLUSH_s = 60.0
PAUSE_s = 15.0
"""Mean time from one act of operators or fate to the next."""

FAULT_s = 20.0
"""Longest duration of a fault; it ends earlier where the drive has tripped."""

DOWN_s = 1.0
"""Time without a daemon at a restart."""

LONGEST_SESSION_s = 2.0 * 3600.0

VAIN_VISITS = 20
"""Visits in a row after which a drive without a fault must have been enabled."""

FAULTS: tuple[Row, ...] = tuple(row for row in ROWS if NAME in row.loads and not row.sticks_on)
WISHES: tuple[Request, ...] = (
    SetSetpoint(3.0),
    SetSetpoint(9.0),
    SetMode(Mode.ADAPTIVE),
    SetMode(Mode.ADAPTIVE),
    SetMode(Mode.FIXED),
    SetMode(Mode.MANUAL),
    SetVoltage(300.0, 0.5),
    SetPole(0.6),
    SetPole(0.9),
    SetWaveform(Waveform(Shape.SQUARE, 2.5, 3.5, 20.0)),
    SetWaveform(None),
    Disable(),
    Reset(),
    Enable(),
)


class Life(Course):
    """One drive for days.

    Attributes:
        must: Whether the drive may be energised.
        counts: Acts, trips by cause, half cycles.
        sessions: What became of each session.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        """Put a motor behind a daemon.

        Args:
            seed: Of everything that happens.
            folder: Takes the session that is being recorded.
        """
        self.must = MustBeOff()
        self.counts: Counter[str] = Counter()
        self.sessions: list[Judged] = []
        self._folder = folder
        self._tripped = False
        self._vain = 0
        super().__init__(NAME, seed)
        self._line = self.drive.world.line.parameters
        self._sigma = self.sigma
        self._adopt()

    # -- what happens ------------------------------------------------------------------------

    def pass_time(self, seconds: float) -> None:
        """Let operators and fate do what they like for some time."""
        end_s = self.daemon.now + seconds
        while self.daemon.now < end_s:
            act = self.draw.choices((self._operate, self._suffer, self._restart), (70, 28, 2))[0]
            act()
            self._bring_up()
            self.run(self.draw.expovariate(1.0 / PAUSE_s))
            if self.daemon.now - self._began_s > LONGEST_SESSION_s:
                self._restart()

    def close(self) -> None:
        """End the session that is being recorded."""
        self.sessions.append(self._tape.judge())

    def _operate(self) -> None:
        if self.draw.random() < 0.6:
            self.step_setpoint()
            self.counts["steps of the set-point"] += 1
            return
        self.counts["other commands"] += 1
        self._ask(self.draw.choice(WISHES))

    def _suffer(self) -> None:
        """Put one fault in, and mend it when the drive has tripped or after some time."""
        self.counts["faults"] += 1
        self.fault_s = self.daemon.now
        row = self.draw.choice(FAULTS)
        row.put(self)
        self.must.trip_cause = self.daemon.port.trip_cause is not None
        self.must.stalled = not self.decides
        self.run(self.draw.uniform(0.1, FAULT_s), until_trip=self.draw.random() < 0.7)
        self._mend()

    def _mend(self) -> None:
        self.sensor, self.lags, self.sigma = honest, 0, self._sigma
        self.actuator, self.frame = (lambda command: command), (lambda reading: reading)
        self.decides, self.daemon.port.trip_cause = True, None
        self.must.stalled = self.must.trip_cause = False
        load = self.drive.world.load
        assert isinstance(load, Motor)
        load.torque_Nm = 0.0
        self.drive.world.line.parameters = self._line
        self.run(2.0)

    def _restart(self) -> None:
        self.counts["restarts of the daemon"] += 1
        self.sessions.append(self._tape.judge())
        for _ in range(int(DOWN_s / self.drive.world.line.half_cycle_s)):
            self.daemon.sleep(self.daemon.now + self.drive.world.line.half_cycle_s)
            self.drive.tick(self.daemon.now)
        self.must.restart()
        self._tripped = False
        self.daemon = DaemonByHand(self.configuration, self._hear, self.daemon.now)
        self._adopt()

    def _adopt(self) -> None:
        self.daemon.port.on_delivery = self._note
        self._tape = Tape(self._folder, self.daemon, self.configuration)
        self._began_s = self._flushed_s = self.daemon.now

    def _bring_up(self) -> None:
        """Do what an operator does who comes by: nothing at once, then reset and enable."""
        if self._is_on():
            return
        self.run(self.draw.uniform(1.0, 10.0))
        self.discharge()
        self._ask(Reset())
        self._ask(Enable())
        self._vain = 0 if self._is_on() else self._vain + 1
        assert self._vain < VAIN_VISITS, f"cannot be enabled: {self.daemon.trip}"
        self._ask(SetMode(Mode.ADAPTIVE))
        self.run(3.0)
        self.step_setpoint()

    def _is_on(self) -> bool:
        return self.daemon.state in {State.RUNNING, State.STARTING}

    def _ask(self, wish: Request) -> None:
        if isinstance(wish, Disable):
            self.must.revoke("it was disabled")
        accepted = self.daemon.accepts(wish)
        if isinstance(wish, Reset) and accepted and self._tripped:
            cause = self.must.cause(self.daemon.now)
            assert cause is None, f"reset although {cause}"
            self._tripped = False
        if isinstance(wish, Enable) and accepted:
            assert not self._tripped, "enabled without a reset"
            self.must.enable(self.daemon.now)
            self.counts["enabled"] += 1

    # -- each half cycle ---------------------------------------------------------------------

    def half_cycle(self) -> None:
        """Let the drive and its daemon live for half a cycle, and record it."""
        super().half_cycle()
        self.counts["half cycles"] += 1
        for report in self.daemon.heard():
            if isinstance(report, LoadReport) and report.decision.fault:
                self.must.revoke("a decision had it stopped")
        if self.daemon.trip is not None and not self._tripped:
            self._tripped = True
            self.counts[f"trip: {self.daemon.trip.partition(':')[0]}"] += 1
        if self._tripped:
            self.must.revoke("it has tripped")
        if self.daemon.now - self._flushed_s >= FLUSH_s:
            self._tape.flush()
            self._flushed_s = self.daemon.now

    def _note(self, reading: Reading) -> None:
        self.must.reading, self.must.readings = reading, self.must.readings + 1

    def _hear(self, command: Command) -> None:
        daemon = getattr(self, "daemon", None)
        self.must.judge(command, 1000.0 if daemon is None else daemon.now)
        super()._hear(command)
