"""Notices that another sender commands the drive: two masters must not drive one load."""

from __future__ import annotations

import math
from collections.abc import Callable

QUIET_S = 5.0
"""Time without a foreign command until the drive may be energised. A sender commands its drive
many times in it, as every drive has a time-out far shorter than this."""


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
