"""The register that a drive advances while its controller runs."""

from __future__ import annotations

import math

from adaptdrive.config.modbus import Heartbeat

STANDS_STILL = "the drive's heartbeat register stands still: its controller hangs"


class DriveHeartbeat:
    """Judges from poll to poll whether a drive's heartbeat advances."""

    def __init__(self, config: Heartbeat) -> None:
        self._watched = config.drive is not None
        self._patience_s = config.drive_timeout_s or 0.0
        self._known: float | None = None
        self._advanced_s = -math.inf

    def forget(self) -> None:
        """Forget the last value: the link was opened again."""
        self._known, self._advanced_s = None, -math.inf

    def beats(self, value: float | None, now_s: float) -> bool | None:
        """Return whether the drive is alive, None while that is not known.

        Args:
            value: Heartbeat of a poll, None where it must not be used.
            now_s: When the poll began, monotonic clock.
        """
        if not self._watched:
            return True
        known, self._known = self._known, value
        if known is None:
            return None  # one value alone shows no life, and neither does the same one again
        if value != known:
            self._advanced_s = now_s
            return True
        return now_s - self._advanced_s <= self._patience_s
