"""Notices that a bus takes no commands of a drive whose messages come.

A full queue of a moment is no sign: the next tick brings a fresher command. A bus that is lost, or
on which nothing comes, takes no commands either; both are reported as such.
"""

from __future__ import annotations

_UNTAKEN_COMMANDS = 3
"""Commands in a row that a bus refuses while readings come: 25 ms of a drive that sends each half
cycle of 60 Hz, well within its own time-out."""


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
