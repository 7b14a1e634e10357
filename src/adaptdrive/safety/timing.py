"""The times of one drive, from which each limit of its obedience follows.

`docs/proof/obedience.md` gives the argument for each of them.
"""

import math
from dataclasses import dataclass

from adaptdrive.config.consistency import LATE_READINGS
from adaptdrive.config.root import Configuration, needed_names

START_TICKS = 30
"""Half cycles to switch on where `interlocks.start_s` is left out: 0.25 s on a 60 Hz line."""

_LOST_READINGS = 2.0
"""Readings until the next one has come where one was lost."""

_SILENT_READINGS = 2.5
"""Readings without one after which a drive is silent: one was lost, and the next one is late."""

_START_READINGS = 3.0
"""Readings that a bridge may take to come on, of a drive that is read seldom."""

_STOP_READINGS = 4.0
"""Readings that a stop may take of a drive that is read seldom: one of them may be lost."""

_COMING_SHARE = 0.5
"""Least share of the time of a stop in which a bridge that has not come on yet may still do so."""

_SHORTEST_TIMEOUT_S = 0.08
"""Time without a command after which a drive may have stopped by its own time-out: none is shorter
than 0.1 s, and the last command was sent before the time began."""

_TIMEOUT_SHARE = 0.8
"""Share of a drive's own time-out in which it stays on for certain: clocks and links differ."""

OBEY_S = 1.0
"""Time that a drive has for the safe command before nothing keeps its own watchdog quiet; a stop
that takes longer by its configuration is not cut short."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one drive; each limit below is made from them alone.

    Attributes:
        half_cycle_s: Half a line cycle at nominal frequency.
        stale_s: Oldest usable measurement, `interlocks.stale_s`.
        ticks_per_reading: Half cycles from one reading to the next, 1 for a drive that sends each.
        start_s: Longest time from the command to a bridge that is on, `interlocks.start_s`; None
            for 30 half cycles.
        stop_s: Longest time from a stop to a bridge that is off, `interlocks.stop_s`.
        command_timeout_s: The drive's own time-out without commands, None where it is not known.
        voltage_parts: Values of which the daemon's voltage loop makes its v_bst, itself among
            them; empty where the drive holds its own.
    """

    half_cycle_s: float
    stale_s: float
    ticks_per_reading: int = 1
    start_s: float | None = None
    stop_s: float = 0.5
    command_timeout_s: float | None = None
    voltage_parts: frozenset[str] = frozenset()

    @property
    def reading_s(self) -> float:
        """Time from one reading to the next, and from one command to the next."""
        return self.ticks_per_reading * self.half_cycle_s

    @property
    def certain_s(self) -> float:
        """Time after its last reading in which the drive's own time-out does not stop it.

        The last command that it has received may be the one before that reading. A time-out that
        is not known gives no limit.
        """
        if self.command_timeout_s is None:
            return math.inf
        share_s = _TIMEOUT_SHARE * self.command_timeout_s
        return min(share_s, self.command_timeout_s - self.reading_s)

    @property
    def unseen_s(self) -> float:
        """Time in which a drive that nobody watches cannot have stopped by its own time-out."""
        return min(_SHORTEST_TIMEOUT_S, self.certain_s)

    def hidden_s(self, cycle_s: float) -> float:
        """Return how late a command may reach the bus without hiding a stop of the drive.

        A known time-out excludes the stop that the command would undo most likely. A stop for any
        other cause is shown by the report that waits, or, of a drive that is polled, is as unseen
        as one between a reading and its command; `overslept_s` limits this time.

        Args:
            cycle_s: Time from one report of the bridge to the next, infinite where it is not known.
        """
        shown = self.command_timeout_s is not None and cycle_s <= _LOST_READINGS * self.reading_s
        return self.certain_s if shown else self.unseen_s

    @property
    def asleep_s(self) -> float:
        """Time without a look at the drive after which it may have stopped unseen."""
        late_s = max(LATE_READINGS * self.reading_s, self.certain_s)
        return max(self.unseen_s, min(_LOST_READINGS * self.reading_s, late_s))

    @property
    def overslept_s(self) -> float:
        """Time without a tick of this process that trips: two readings leave nothing to see."""
        return max(self.stale_s, _LOST_READINGS * self.reading_s)

    @property
    def frozen_s(self) -> float:
        """Time without a step of a port that polls, after which its process has stood still.

        No reply that a running process awaits takes as long: its time-out is shorter than a poll.
        """
        return _LOST_READINGS * self.reading_s

    @property
    def usual_s(self) -> float:
        """Age of a report at which nothing is unusual: the next one is late at the most."""
        return LATE_READINGS * self.reading_s

    @property
    def command_pause_s(self) -> float:
        """Time without a command that the drive must stand: one was lost, the next one is late."""
        return _SILENT_READINGS * self.reading_s

    @property
    def silent_s(self) -> float:
        """Time without a reading after which the drive may have stopped by itself.

        A long time-out of the drive does not lengthen it: a silent drive may have started anew,
        too, and needs no command meanwhile.
        """
        return min(self._silence_s(self.reading_s), self.certain_s)

    def unreported_s(self, cycle_s: float) -> float:
        """Return how long the report of the bridge alone may be missing.

        A report that comes less often than a drive may be silent is not waited for each time. How
        often it comes does not matter while the drive's own time-out leaves it on.

        Args:
            cycle_s: Time from one report to the next, 0 where each reading has one, infinite where
                it is not known.
        """
        certain_s = self.certain_s
        if cycle_s == math.inf:
            limit_s = 0.0 if certain_s == math.inf else certain_s
        else:
            limit_s = self._silence_s(cycle_s)
            limit_s = limit_s if cycle_s > certain_s else min(limit_s, certain_s)
        return max(self.silent_s, limit_s)

    @property
    def switched_on_s(self) -> float:
        """Time after which a bridge that was commanded on must have been reported on."""
        return max(self._start_s, _START_READINGS * self.reading_s)

    @property
    def switched_off_s(self) -> float:
        """Time after which a bridge that was commanded off must have been reported off."""
        return max(self.stop_s, _STOP_READINGS * self.reading_s)

    @property
    def coming_s(self) -> float:
        """Time after a stop in which a bridge that has not come on yet may still do so.

        A drive that obeys late reports off until then. It leaves two readings of the time of the
        stop for a report that counts, or half of that time.
        """
        left_s = self.switched_off_s - _LOST_READINGS * self.reading_s
        least_s = max(_COMING_SHARE * self.stop_s, self.reading_s)
        return max(least_s, min(self._start_s, left_s))

    @property
    def taken_s(self) -> float:
        """Time after which the safe command must have been acknowledged where a bus does that."""
        return OBEY_S + self.reading_s

    def obeyed_s(self, report_s: float) -> float:
        """Return the time after which a drive that is still on does not obey the safe command.

        Args:
            report_s: Time from one report of its bridge to the next, infinite where not known.
        """
        return max(OBEY_S, self.stop_s + (report_s if report_s < math.inf else 0.0))

    @property
    def _start_s(self) -> float:
        return START_TICKS * self.half_cycle_s if self.start_s is None else self.start_s

    @staticmethod
    def _silence_s(cycle_s: float) -> float:
        return max(_SHORTEST_TIMEOUT_S, _SILENT_READINGS * cycle_s)


def timing_of(configuration: Configuration) -> Timing:
    """Return the times of a drive, of which each limit of its obedience is made.

    Args:
        configuration: Its configuration.
    """
    in_daemon = configuration.voltage_loop.where == "daemon"
    voltage = ("boost_voltage_V",) if in_daemon else ()
    return Timing(
        half_cycle_s=configuration.drive.half_cycle_s,
        stale_s=configuration.interlocks.stale_s,
        ticks_per_reading=configuration.bus.ticks_per_reading,
        start_s=configuration.interlocks.start_s,
        stop_s=configuration.interlocks.stop_s,
        command_timeout_s=configuration.bus.command_timeout_s,
        voltage_parts=frozenset(needed_names(configuration.derived, voltage)),
    )
