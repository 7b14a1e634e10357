"""Notices a drive that has stopped by itself: it must not be driven on as if it had not."""

from __future__ import annotations

import math

from adaptdrive.hardware.port import Reading

_GRACE_TICKS = 30
"""Half cycles that a bridge may take to switch: 0.25 s on a 60 Hz line."""

_GRACE_READINGS = 3
"""The same in readings, for a drive that is read seldom."""

_GAP_READINGS = 2
"""Readings that pass unwatched before a bridge that was on and is off is a stop, not a flicker."""


_SHORTEST_TIMEOUT_S = 0.08
"""Time without a command after which a drive may have stopped by its own time-out: none is shorter
than 0.1 s, and the last command was sent before the time began."""

_SLACK_S = 1e-6
"""Rounding of sums of half cycles: the last one within the grace is not yet a stop."""


class BridgeWatch:
    """Measures how long a drive has reported its bridge off although it was commanded on."""

    def __init__(self, tick_s: float, ticks_per_reading: int) -> None:
        """Watch from the first half cycle.

        Args:
            tick_s: Half a line cycle at nominal frequency.
            ticks_per_reading: Half cycles from one reading to the next.
        """
        self._reading_s = ticks_per_reading * tick_s
        self._grace_s = max(_GRACE_TICKS * tick_s, _GRACE_READINGS * self._reading_s)
        self._gap_limit_s = _GAP_READINGS * self._reading_s
        self._off_s: float | None = None
        self._due_s: float | None = None
        self._been_on = False
        self._gap_s = 0.0
        self._gap_end_s = -math.inf

    def find_cause(
        self, reading: Reading, *, commanded: bool, due: bool, unwatched_s: float, now_s: float
    ) -> str | None:
        """Return the cause of a trip, None for none.

        Only reports of the drive count: one that has fallen silent is stale, not off. A bridge that
        went off unwatched is a stop at once: a drive that stopped because this process did not run
        gets no command that energises it anew. A report from before the end of that time says
        nothing of it. A report from before the command says nothing of what follows it.

        Args:
            reading: The newest reading.
            commanded: Whether the last command had the bridge on.
            due: Whether a bridge that has not been on yet must come on; not while a drive starts.
            unwatched_s: Time since the last look.
            now_s: Monotonic time of this look.
        """
        self._note_gap(unwatched_s, now_s)
        self._note_due(now_s, due=commanded and (due or self._been_on))
        reported_s = reading.bridge_reported_s
        if reading.bridge or not commanded:
            self._off_s, self._been_on = None, commanded
            if reported_s > self._gap_end_s or not commanded:
                self._gap_s = 0.0
            return None
        if self._due_s is None:
            return None
        if self._off_s is None:
            self._off_s = max(reported_s, self._due_s) - self._reading_s
        slept = self._been_on and self._gap_s > 0.0
        if reported_s - self._off_s <= self._grace_s + _SLACK_S and not slept:
            return None
        gap = (
            f"; the daemon had not run for {self._gap_s * 1e3:.0f} ms" if self.awaits_report else ""
        )
        return f"drive stopped: its bridge is off although it was commanded on{gap}"

    @property
    def awaits_report(self) -> bool:
        """True while a drive that was on may have stopped by itself, and has not reported since."""
        return self._been_on and self._gap_s > _SHORTEST_TIMEOUT_S

    def _note_due(self, now_s: float, *, due: bool) -> None:
        """Keep the time from which on the bridge must be on, or soon after."""
        if not due:
            self._due_s = None
        elif self._due_s is None:
            self._due_s = now_s

    def _note_gap(self, unwatched_s: float, now_s: float) -> None:
        """Keep the longest time in which a bridge may have gone off, until a report from after."""
        if unwatched_s > self._gap_limit_s:
            self._gap_s, self._gap_end_s = max(self._gap_s, unwatched_s), now_s
