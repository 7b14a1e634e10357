"""Keeps a drive that stopped while nothing was heard of it from being energised afterwards."""

from __future__ import annotations

_STOPPED = "drive stopped: its bridge is off although it was commanded on"

LOST = "the bus was lost meanwhile"
LEAPT = "its alive counter leapt meanwhile: it may have started anew"
UNANSWERED = "a read had no answer meanwhile"
UNREAD = "no poll gave a reading meanwhile"
REFUSED = "its other values were refused meanwhile"


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
        self._glimpsed_on = False
        self._stopped = False
        self._how = LOST

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive, None for none."""
        return f"{_STOPPED}; {self._how}" if self._stopped else None

    def open(self, *, bridge: bool, how: str = LOST) -> None:
        """Begin a connection, or a silence of one.

        Args:
            bridge: Whether the last command that reached the drive had the bridge on.
            how: Why nothing is heard of the drive.
        """
        if not (self._was_on and how == UNREAD):  # what keeps the readings away says more
            self._how = how
        self._was_on = self._commanded and (self._was_on or bridge)

    def glimpse_on(self, how: str = LOST) -> None:
        """Note a report of the bridge on that no reading carries, of a drive commanded on.

        It keeps no command back. If the next reading has it off, the drive has stopped meanwhile.

        Args:
            how: Why no reading carries it.
        """
        self._glimpsed_on, self._how = self._commanded, how

    def hear(self, *, bridge: bool) -> None:
        """Note a reading.

        Args:
            bridge: Whether it has the bridge on.
        """
        lost = self._glimpsed_on or (self._was_on and self._reported_on)
        self._stopped = self._stopped or (lost and not bridge)
        self._was_on, self._reported_on, self._glimpsed_on = False, bridge, False

    def note(self, *, bridge: bool, safe: bool) -> None:
        """Note a command, sent or not; the safe one ends what was driven.

        Args:
            bridge: Whether it has the bridge on.
            safe: Whether it is the safe command.
        """
        self._commanded = bridge
        self._glimpsed_on = self._glimpsed_on and bridge
        if safe:
            self._stopped = self._was_on = False

    def admits(self, *, bridge: bool) -> bool:
        """Return whether a command may be sent.

        Args:
            bridge: Whether it has the bridge on.
        """
        return not (bridge and (self._was_on or self._stopped))
