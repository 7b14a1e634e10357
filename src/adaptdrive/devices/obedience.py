"""Doubts about a drive: whether it has stopped, whether it obeys, and whether others command it.

A drive that stopped while nothing was heard of it is not energised afterwards. One that does not
obey the safe command must not be kept from stopping by itself, by commands or by heartbeats; how it
is kept from that is a matter of its bus. Two masters must not drive one load.

A bus may take no commands of a drive whose messages come. A full queue of a moment is no sign: the
next tick brings a fresher command. A bus that is lost, or on which nothing comes, takes no commands
either; both are reported as such.
"""

from __future__ import annotations

import math
from collections.abc import Callable

_STOPPED = "drive stopped: its bridge is off although it was commanded on"

LOST = "the bus was lost meanwhile"
LEAPT = "its alive counter leapt meanwhile: it may have started anew"
UNANSWERED = "a read had no answer meanwhile"
UNREAD = "no poll gave a reading meanwhile"

QUIET_S = 5.0
"""Time without a foreign command until the drive may be energised. A sender commands its drive
many times in it, as every drive has a time-out far shorter than this."""

_UNTAKEN_COMMANDS = 3
"""Commands in a row that a bus refuses while readings come: 25 ms of a drive that sends each half
cycle of 60 Hz, well within its own time-out."""


class Relink:
    """A drive that was on when its bus was lost or fell silent, until the next reading.

    The drive may have stopped by its own time-out meanwhile, or have started anew. A command that
    has the bridge on waits for the reading. If that has the bridge off and the last one before the
    loss had it on, the drive is not driven on; one that was about to start may continue.
    """

    def __init__(self) -> None:
        """Begin without a connection, and without a command."""
        self._commanded = False
        self._was_on = False
        self._reported_on = False
        self._stopped = False
        self._how = LOST

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive, None for none."""
        return f"{_STOPPED}; {self._how}" if self._stopped else None

    def open(self, *, bridge: bool, how: str = LOST, glimpsed: bool = False) -> None:
        """Begin a connection, or a silence of one.

        Args:
            bridge: Whether the last command that reached the drive had the bridge on.
            how: Why nothing is heard of the drive.
            glimpsed: Whether its last report, also one that no reading carries, has it on.
        """
        if not (self._was_on and how in {UNREAD, LEAPT}):  # what was there before says more
            self._how = how
        self._was_on = self._commanded and (self._was_on or bridge)
        self._reported_on = self._reported_on or glimpsed

    def hear(self, *, bridge: bool) -> None:
        """Note a reading.

        Args:
            bridge: Whether it has the bridge on.
        """
        self._stopped = self._stopped or (self._was_on and self._reported_on and not bridge)
        self._was_on, self._reported_on = False, bridge

    def note(self, *, bridge: bool, safe: bool) -> None:
        """Note a command, sent or not; the safe one ends what was driven.

        Args:
            bridge: Whether it has the bridge on.
            safe: Whether it is the safe command.
        """
        self._commanded = bridge
        if safe:
            self._stopped = self._was_on = False

    def admits(self, *, bridge: bool) -> bool:
        """Return whether a command may be sent.

        Args:
            bridge: Whether it has the bridge on.
        """
        return not (bridge and (self._was_on or self._stopped))


class Obedience:
    """Times the safe command in force from when the drive may first have heard it.

    Attributes:
        heard_s: That time by the monotonic clock, infinite while no safe command is in force.
    """

    def __init__(self, limit_s: float, clock: Callable[[], float]) -> None:
        """Note no command yet.

        Args:
            limit_s: Time that the drive has to obey, `Timing.obeyed_s`.
            clock: Monotonic clock, in s.
        """
        self._limit_s = limit_s
        self._clock = clock
        self.heard_s = math.inf

    @property
    def awaited(self) -> bool:
        """True while a safe command is in force."""
        return self.heard_s < math.inf

    def hear(self) -> None:
        """Note that the drive may hear the safe command now; the first time counts."""
        if self.heard_s == math.inf:
            self.heard_s = self._clock()

    def forget(self) -> None:
        """Note another command, or the loss of a bus on which nothing shows what was heard."""
        self.heard_s = math.inf

    def overdue_s(self, *, powered: bool) -> float:
        """Return for how long a drive has not obeyed the safe command, negative while it may yet.

        Args:
            powered: Whether its last report, also one of a link before, has it energised.
        """
        return self._clock() - self.heard_s - self._limit_s if powered else -math.inf


class Rival:
    """Remembers the last command frame on the bus that this process has not sent."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Start without another sender.

        Args:
            clock: Monotonic clock, in seconds.
        """
        self._clock = clock
        self._frame = ""
        self._count = 0
        self._heard_s = -math.inf

    def hear(self, frame: str) -> None:
        """Note a foreign command frame.

        Args:
            frame: The frame's id and name, as text.
        """
        now_s = self._clock()
        self._count = 1 if now_s - self._heard_s > QUIET_S else self._count + 1
        self._frame, self._heard_s = frame, now_s

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive, None without a recent foreign command."""
        if not self._count:
            return None
        age_s = self._clock() - self._heard_s
        if age_s > QUIET_S:
            return None
        return (
            f"another sender commands this drive: {self._count} x frame {self._frame}, the last "
            f"{age_s:.1f} s ago; end the other daemon, PLC or tool: the bus must be free of its "
            f"commands for {QUIET_S:g} s"
        )


class Uptake:
    """Count of the commands of one drive that its open bus has refused in a row."""

    def __init__(self) -> None:
        self._untaken = 0
        self._heard = False

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive: commands do not reach the bus, None for no reason."""
        if self._untaken < _UNTAKEN_COMMANDS:
            return None
        return (
            f"the bus does not take commands: {self._untaken} in a row were refused while the "
            "drive's messages came; look for another sender that keeps the bus busy, and for an "
            "adapter that sends nothing"
        )

    def forget(self) -> None:
        """Begin anew: the bus was opened, or is lost."""
        self._untaken, self._heard = 0, False

    def hear(self) -> None:
        """Note a reading of the drive: the bus is there, and the drive on it."""
        self._heard = True

    def note(self, *, taken: bool) -> None:
        """Note whether the bus took the whole of a command; of several after a reading one counts.

        Args:
            taken: Whether it did.
        """
        self._untaken = 0 if taken else self._untaken + self._heard
        self._heard = False
