"""When a drive must be off: a model of its own, from the manual, which sees the bus and the clock.

It judges each command that reaches the bus. It does not ask the daemon anything: what the operator
asked for, what the drive said, and when the daemon last ran are all that it goes by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from adaptdrive.control.signals import Command
from adaptdrive.safety.facts import Reading

BOOST_MAX_V = 430.0
OUTPUT_MAX_V = 5.0
SLACK_s = 1e-6
RATE_READINGS = 60
OFF_COMMANDS = 34
"""Commands in a row after which a bridge that stays off is a drive that has stopped."""

START_s = 30 / 120.0
"""Time that a drive has to close its bridge: a faster line gives it no less."""

OWN_TIMEOUT_s = 0.1
"""Time without a command after which the drive stops by itself, be it heard or not."""

UNDECIDED_COMMANDS = 540
"""Commands in a row after which a slow loop that decides nothing has been missed."""


@dataclass
class MustBeOff:
    """What is known on the outside of the daemon, and whether the drive may be energised.

    Attributes:
        stale_s: Oldest usable measurement.
        own_timeout_s: Time without a command after which the drive stops by itself.
        start_s: Time that the drive may take to switch its bridge on.
        enabled: Whether `enable` has been accepted, and nothing has revoked it since.
        why_not: What revoked it last.
        reading: The last reading that was handed over.
        readings: How many have been, since the daemon was started.
        judged: The reading at the last command.
        trip_cause: What another sender does, as the bus sees it.
        ran_s: When the daemon last ran: it sent a command, or a stand-in tick came without one.
        stalled: Whether the slow loop decides nothing.
        refused: Readings in a row with the bridge off after commands with it on: silence is none.
        refused_from_s: When the first of them was sent.
        undecided: Commands in a row with the bridge on that a stalled slow loop has not seen.
        commanded: Whether the last command had the bridge on.
        lingers: Whether the bridge was still on when it was commanded on.
        been_on: Whether the bridge has come on by the command in force.
    """

    stale_s: float = 0.05
    own_timeout_s: float = OWN_TIMEOUT_s
    start_s: float = START_s

    enabled: bool = False
    why_not: str = "nobody has enabled it"
    reading: Reading | None = None
    readings: int = 0
    trip_cause: bool = False
    ran_s: float = math.inf
    stalled: bool = False
    refused: int = 0
    judged: Reading | None = None
    refused_from_s: float = math.inf
    undecided: int = 0
    commanded: bool = False
    lingers: bool = False
    been_on: bool = False

    def cause(self, now_s: float) -> str | None:
        """Return why no drive may be energised now, None for no reason."""
        reading = self.reading
        if reading is None:
            return "nothing was measured"
        values = (reading.boost_voltage_V, reading.line_voltage_V, reading.load_power_W)
        causes = {
            "the measurement is old": now_s - reading.oldest_s > self.stale_s + SLACK_s,
            "a value is no number": not all(map(math.isfinite, (*values, reading.output))),
            "the drive has a fault": reading.fault != 0,
            "over-voltage": reading.boost_voltage_V > BOOST_MAX_V,
            "the output is too high": reading.output > OUTPUT_MAX_V,
            "another sender commands the drive": self.trip_cause,
        }
        return next((cause for cause, active in causes.items() if active), None)

    def judge(self, command: Command, now_s: float) -> None:
        """Take a command that reaches the bus.

        Raises:
            AssertionError: It energises a drive that must be off.
        """
        between_ticks = now_s == self.ran_s and not self._energises(command)
        cause = self.cause(now_s) or self._while_energised(now_s)
        if cause is not None and not between_ticks:  # a request alone made it: the tick is to come
            self.revoke(cause)
        self.ran_s = now_s
        if self._energises(command):
            assert self.enabled, f"energised although {self.why_not}: {command}"
            assert self.readings >= RATE_READINGS, "energised before the rate was judged"
            assert not self._unheard(now_s), "energised although it may have stopped unheard"
        reported = self.reading is not None and self.reading.bridge
        if not self.refused:
            self.refused_from_s = now_s
        news, self.judged = self.reading is not self.judged, self.reading
        self.refused = self.refused + news if command.bridge and not reported else 0
        self.undecided = self.undecided + 1 if command.bridge and self.stalled else 0
        self._note_bridge(command, on=reported)

    def note_run(self, ran_s: float) -> None:
        """Take that a stand-in tick ran, which may send nothing to a drive that is silent."""
        self.ran_s = max(self.ran_s, ran_s)

    def _unheard(self, now_s: float) -> bool:
        """Return whether a drive that was on has been silent for longer than its own time-out."""
        silent_s = 0.0 if self.reading is None else now_s - self.reading.arrival_s
        return self.been_on and silent_s > self.own_timeout_s

    def _note_bridge(self, command: Command, *, on: bool) -> None:
        """Keep whether the bridge has come on by the command, not still is by the one before."""
        if not command.bridge:
            self.commanded = self.been_on = False
            return
        self.lingers = on and (self.lingers or not self.commanded)
        self.been_on = self.been_on or (on and self.commanded and not self.lingers)
        self.commanded = True

    def _while_energised(self, now_s: float) -> str | None:
        """Return what stops a drive only while it is energised."""
        if not self.enabled:
            return None
        if now_s - self.ran_s > self.stale_s + SLACK_s:
            return "the daemon did not run"
        if self.undecided > UNDECIDED_COMMANDS:
            return "the slow loop is behind"
        if self.been_on and self.reading is not None and not self.reading.bridge:
            return "the drive has stopped by itself, or has started anew"
        off_s = self.start_s + (OFF_COMMANDS - 30) / 120.0
        if self.refused > OFF_COMMANDS and now_s - self.refused_from_s > off_s:
            return "the drive has not switched its bridge on"
        return None

    def enable(self, now_s: float) -> None:
        """Take an `enable` that was accepted.

        Raises:
            AssertionError: It must have been refused.
        """
        if self.enabled:
            return
        cause = self.cause(now_s)
        assert cause is None, f"enabled although {cause}"
        self.enabled, self.refused, self.undecided = True, 0, 0

    def revoke(self, why: str) -> None:
        """Whoever wants the drive to run must enable it again."""
        if self.enabled:
            self.enabled, self.why_not = False, why

    def restart(self) -> None:
        """A new daemon: nobody has enabled anything."""
        self.revoke("the daemon was restarted")
        self.reading, self.readings, self.refused, self.undecided = None, 0, 0, 0
        self.commanded = self.lingers = self.been_on = False
        self.ran_s = math.inf

    @staticmethod
    def _energises(command: Command) -> bool:
        return command.bridge or command.current_scale_S != 0.0 or command.boost_reference_V != 0.0
