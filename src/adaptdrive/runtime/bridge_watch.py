"""Notices a drive that has stopped by itself: it must not be driven on as if it had not."""

from __future__ import annotations

from adaptdrive.hardware.port import Reading

_GRACE_TICKS = 30
"""Half cycles that a bridge may take to switch: 0.25 s on a 60 Hz line."""

_GRACE_READINGS = 3
"""The same in readings, for a drive that is read seldom."""

_GAP_READINGS = 3
"""Readings that pass unwatched before a bridge that was on and is off is a stop, not a flicker."""


class BridgeWatch:
    """Counts half cycles in which a bridge is off that was commanded on."""

    def __init__(self, tick_s: float, ticks_per_reading: int) -> None:
        """Watch from the first half cycle.

        Args:
            tick_s: Half a line cycle at nominal frequency.
            ticks_per_reading: Half cycles from one reading to the next.
        """
        self._tick_s = tick_s
        self._stride = ticks_per_reading
        self._grace = max(_GRACE_TICKS, _GRACE_READINGS * ticks_per_reading)
        self._off_ticks = 0
        self._been_on = False

    def find_cause(
        self, reading: Reading | None, *, commanded: bool, unwatched_s: float
    ) -> str | None:
        """One more look; the cause of a trip, None for none.

        Half cycles that passed unwatched count, and a bridge that went off unwatched is
        a stop at once: a drive that stopped because this process did not run gets no command that
        energises it anew.

        Args:
            reading: The newest reading.
            commanded: Whether the last command had the bridge on.
            unwatched_s: Time since the last look.
        """
        if reading is None or reading.bridge or not commanded:
            self._off_ticks, self._been_on = 0, commanded and reading is not None
            return None
        missed_ticks = unwatched_s / self._tick_s
        self._off_ticks += max(self._stride, int(missed_ticks))
        slept = self._been_on and missed_ticks > _GAP_READINGS * self._stride
        if self._off_ticks <= self._grace and not slept:
            return None
        return "drive stopped: its bridge is off although it was commanded on"
