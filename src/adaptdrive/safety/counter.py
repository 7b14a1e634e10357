"""Finds old frames, and a drive that has started anew, by the drive's count of half cycles.

A count that keeps step with the one that is accepted is accepted in its place, if it is a newer
one: it is that of the drive as it was, whatever was lost and however often it has wrapped. One that
does not is accepted once those after it have kept step with it, and not with the one before.

A drive that has started anew must not be driven on. It may do so so quickly that no reading is
missed for long, and the commands of that time have switched it on again before its first report.
Its count then begins at 0. One that may have done so is suspect. If the frames after it keep step
with that from before, it was late, or repeated; frames that waited come at once and are soon over.
If they keep step with the suspect one alone, the drive has started anew.

A drive that hangs, or a gateway, may repeat its last frame for ever, or several of them in turn:
these advance from one to the next, and back. A count that stands, or is behind the newest one, is
therefore that of an old frame. One that has leapt back must keep step for longer than a reading may
be old, before it is accepted.
"""

import math

from adaptdrive.safety.trips import Trip, TripKind

SLACK_TICKS = 3
"""Permitted difference of count and time, in half cycles, for jitter of the arrival."""

_DRIFT = 0.04
"""The same per half cycle that passes: line and measured half cycle may be 2 % off each."""

_BEGUN_TICKS = 2 * SLACK_TICKS
"""The same of a count that began at 0 after the frame before, which may have been late itself."""

_PACE_TICKS = 1.0
"""Difference within which the frames after a suspect one keep step with it."""

_SURE_TICKS = 2.5
"""Half cycles after a suspect frame at which frames that had waited are over."""

_OLDER_SHARE = 0.25
"""Share of its range by which a repeated count is older than the newest, at the most."""

_BACK_TICKS = 7.5
"""Half cycles that a counter must keep step after it has leapt back before that is accepted."""

_BACK_SHARE = 1.1
"""The same as a share of the longest age of a reading: frames that are repeated in turn, however
many they are, have stood for longer by then."""

_Count = tuple[int, float]
"""The count of a frame, and its arrival by the monotonic clock."""


class CounterWatch:
    """Compares the count of each frame with those before and with time."""

    def __init__(self, modulus: int | None, tick_s: float, stale_s: float = 0.0) -> None:
        """Start without a frame.

        Args:
            modulus: Where the drive's counter wraps, None for a drive without one.
            tick_s: Half a line cycle at nominal frequency.
            stale_s: Longest age of a reading.
        """
        self._modulus = modulus or 0
        self._tick_s = tick_s
        self._back_ticks = max(_BACK_TICKS, _BACK_SHARE * stale_s / tick_s - 0.5)
        self._seen_s = -math.inf
        self._newest: _Count = (0, -math.inf)
        self._accepted: _Count | None = None
        self._suspect: _Count | None = None
        self._stray: _Count | None = None
        self._cause: Trip | None = None

    @property
    def may_have_restarted(self) -> bool:
        """True while the drive may have started anew."""
        return self._suspect is not None or self._cause is not None

    def add(self, counter: int | None, arrival_s: float, tick_s: float) -> bool:
        """Take the count of a reading; return whether it is an old one.

        Args:
            counter: The drive's counter as sent.
            arrival_s: Arrival of the reading, monotonic clock.
            tick_s: Half a line cycle as measured.
        """
        if counter is None or not self._modulus:
            return False
        self._tick_s = tick_s
        count, quiet = (counter, arrival_s), (arrival_s - self._seen_s) / tick_s
        self._seen_s, before = arrival_s, self._accepted
        self._judge(count)
        if self._accepted != before:
            return False
        if self._is_behind(count) and quiet < 0.5 * self._modulus:  # else it may have come round
            return True
        ahead = (counter - self._newest[0]) % self._modulus
        if ahead <= self._passed(self._newest, count) + SLACK_TICKS:
            self._newest = count
        return False

    def find_cause(self, *, commanded: bool) -> Trip | None:
        """Return the cause of a trip, None for none.

        Args:
            commanded: Whether the last command had the bridge on; else a drive may start anew.
        """
        if not commanded:
            self._cause = None
            if self._suspect is not None:
                self._accept(self._suspect)
        return self._cause

    def _judge(self, count: _Count) -> None:
        """Accept a count that keeps step, or that has kept step with one that did not."""
        accepted, suspect, stray = self._accepted, self._suspect, self._stray
        if accepted is None:
            self._accept(count)
        elif self._off(accepted, count) <= SLACK_TICKS:
            if not self._is_behind(count):
                self._accept(count)
        elif suspect is not None and self._off(suspect, count) <= _PACE_TICKS:
            if self._passed(suspect, count) >= _SURE_TICKS:
                self._note_restart(accepted, suspect)
                self._accept(count)
        elif count[0] <= self._passed(accepted, count) + _BEGUN_TICKS:
            self._suspect, self._stray = count, None
        elif stray is not None and self._off(stray, count) <= _PACE_TICKS:
            sure_ticks = self._back_ticks if self._is_behind(stray) else _SURE_TICKS
            if self._passed(stray, count) >= sure_ticks:
                self._accept(count)
        else:
            self._stray = count

    def _accept(self, count: _Count) -> None:
        """Compare the counts after this one with it alone."""
        self._accepted = self._newest = count
        self._suspect = self._stray = None

    def _is_behind(self, count: _Count) -> bool:
        """Return whether a count is that of an older frame than the newest, or the same again."""
        limit = _OLDER_SHARE * self._modulus
        if self._suspect is not None:  # it may be that of a drive that has started anew
            limit = min(limit, _BEGUN_TICKS + 1)
        return (self._newest[0] - count[0]) % self._modulus < limit

    def _note_restart(self, before: _Count, anew: _Count) -> None:
        due = round(before[0] + self._passed(before, anew)) % self._modulus
        text = f"drive restarted: its half-cycle counter began anew, {anew[0]} where {due} was due"
        self._cause = Trip(TripKind.DRIVE_RESTARTED, text)

    def _off(self, since: _Count, count: _Count) -> float:
        """Return the half cycles by which a count is off, beyond what a line drifts meanwhile."""
        passed = self._passed(since, count)
        off = (count[0] - since[0] - passed) % self._modulus
        return min(off, self._modulus - off) - _DRIFT * abs(passed)

    def _passed(self, since: _Count, count: _Count) -> float:
        """Return the half cycles between the arrivals of two counts."""
        return (count[1] - since[1]) / self._tick_s
