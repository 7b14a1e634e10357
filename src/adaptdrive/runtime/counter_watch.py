"""Finds old frames, and a drive that has started anew, by the drive's own count of half cycles.

A drive that hangs, or a gateway, may repeat its last frame for ever, or several of them in turn:
these advance from one to the next, and back. A count that stands, or is behind the newest one, is
therefore that of an old frame. A count that has leapt elsewhere, as of a drive that starts anew, is
the newest once it has advanced from there for a time: longer than a reading may be old if it has
leapt back. That of a drive that starts anew at 0 is so at once.

A drive that has started anew must not be driven on. It may do so so quickly that no reading is
missed for long, and the commands of that time have switched it on again before its first report.
Its count then begins at 0.

A count that keeps step with time is that of the drive as it was, whatever was lost and however
often it has wrapped. One that does not, and that may have begun at 0 since the frame before, is in
doubt. If the frames after it keep step with that from before, it was late, or repeated; frames that
waited come at once and are soon over. If they keep step with the doubtful one alone, the drive has
started anew.

A count that fits neither may be that of an old frame. It changes nothing, unless those after it
keep step with it: the counter has jumped. Nor does one that stands, or that is older.
"""

from __future__ import annotations

import math

SLACK_TICKS = 3
"""Permitted difference of count and time, in half cycles, for jitter of the arrival."""

_DRIFT = 0.04
"""The same per half cycle that passes: line and measured half cycle may be 2 % off each."""

_BEGUN_TICKS = 2 * SLACK_TICKS
"""The same of a count that began at 0 after the frame before, which may have been late itself."""

_RESTART_TICKS = 2 * SLACK_TICKS
"""Half cycles that a count near 0 is behind the newest where the drive has started anew: frames in
the wrong order are behind by less."""

_PACE_TICKS = 1.0
"""Difference within which the frames after a doubtful one keep step with it."""

_SURE_TICKS = 2.5
"""Half cycles after a doubtful frame at which frames that had waited are over."""

_OLDER_SHARE = 0.25
"""Share of its range by which a repeated count is older than the newest, at the most."""

_ANEW_TICKS = 7.5
"""Half cycles that a counter must keep advancing before a jump is accepted."""

_ANEW_SHARE = 1.1
"""The same as a share of the longest age of a reading, of one that has leapt back: frames that are
repeated in turn, however many they are, have stood for longer by then."""

_BOOT_TICKS = 60
"""Half cycles from one leap to the next between which a drive cannot have started anew: 0.5 s."""

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
        self._anew_ticks = max(_ANEW_TICKS, _ANEW_SHARE * stale_s / tick_s - 0.5)
        self._seen: _Count | None = None
        self._newest: _Count = (0, -math.inf)
        self._risen_s = self._leapt_s = -math.inf
        self._anew = False
        self._last: _Count | None = None
        self._before: _Count | None = None
        self._stray: _Count | None = None
        self._cause: str | None = None

    @property
    def in_doubt(self) -> bool:
        """True while the drive may have started anew."""
        return self._before is not None or self._cause is not None

    def see(self, counter: int | None, arrival_s: float, tick_s: float) -> bool:
        """Take the count of a reading; return whether it is an old one.

        Args:
            counter: The drive's counter as sent.
            arrival_s: Arrival of the reading, monotonic clock.
            tick_s: Half a line cycle as measured.
        """
        if counter is None or not self._modulus:
            return False
        self._tick_s = tick_s
        count = (counter, arrival_s)
        self._watch_restart(count)
        return self._is_old(count)

    def find_cause(self, *, commanded: bool) -> str | None:
        """Return the cause of a trip, None for none.

        Args:
            commanded: Whether the last command had the bridge on; else a drive may start anew.
        """
        if not commanded:
            self._before = self._cause = None
        return self._cause

    def _is_old(self, count: _Count) -> bool:
        seen, self._seen = self._seen, count
        if seen is None:
            self._newest = count
            return False
        if not self._may_follow(seen, count):
            self._risen_s = count[1]
            self._leap(seen, count)
        is_behind = self._is_behind(seen, count)
        in_time = not is_behind and self._may_follow(self._newest, count)
        risen = (count[1] - self._risen_s) / self._tick_s
        if in_time or risen >= (self._anew_ticks if is_behind else _ANEW_TICKS):
            self._newest = count
            return False
        return is_behind

    def _is_behind(self, seen: _Count, count: _Count) -> bool:
        """Return whether a count is behind the newest one.

        One that had time to come round is not, nor is that of a drive that has started anew.
        """
        behind = (self._newest[0] - count[0]) % self._modulus
        may_wrap = self._passed(seen, count) >= 0.5 * self._modulus
        if may_wrap or (self._anew and behind > _RESTART_TICKS):
            return False
        return behind < _OLDER_SHARE * self._modulus

    def _leap(self, seen: _Count, count: _Count) -> None:
        """Note whether a count that does not follow the last one is that of a drive started anew.

        It may have begun at 0 since then. Frames that are repeated in turn leap back to the oldest
        of them, and soon again; those in the wrong order leap back by less.
        """
        if (seen[0] - count[0]) % self._modulus <= _RESTART_TICKS:
            return
        begins = count[0] <= self._passed(seen, count) + SLACK_TICKS
        self._anew = begins and (count[1] - self._leapt_s) / self._tick_s > _BOOT_TICKS
        self._leapt_s = count[1]

    def _may_follow(self, earlier: _Count, count: _Count) -> bool:
        """Return whether a count can come after another: it does not advance faster than time."""
        ahead = (count[0] - earlier[0]) % self._modulus
        return 0 < ahead <= self._passed(earlier, count) + SLACK_TICKS

    def _watch_restart(self, count: _Count) -> None:
        last, before = self._last, self._before
        if last is None:
            self._last = count
        elif self._off(before or last, count) <= SLACK_TICKS:
            self._follow(before or last, count)
        elif before is None or self._off(last, count) > _PACE_TICKS:
            self._doubt(before or last, count)
        elif self._passed(last, count) >= _SURE_TICKS:
            self._settle(before, last)

    def _follow(self, since: _Count, count: _Count) -> None:
        """Take a count that keeps step for that of the drive as it was, if it is a newer one."""
        if (since[0] - count[0]) % self._modulus > SLACK_TICKS:
            self._begin(count)

    def _begin(self, count: _Count) -> None:
        """Compare the counts after this one with it alone."""
        self._last, self._before, self._stray = count, None, None

    def _doubt(self, since: _Count, count: _Count) -> None:
        """Doubt a count that has leapt if it is one of a drive that starts anew."""
        if count[0] <= self._passed(since, count) + _BEGUN_TICKS:
            self._last, self._before, self._stray = count, since, None
        elif self._stray is None or self._off(self._stray, count) > _PACE_TICKS:
            self._stray = count
        elif self._passed(self._stray, count) >= _SURE_TICKS:
            self._begin(count)

    def _settle(self, before: _Count, anew: _Count) -> None:
        """Note that the drive has started anew."""
        due = round(before[0] + self._passed(before, anew)) % self._modulus
        self._cause = (
            f"drive restarted: its half-cycle counter began anew, {anew[0]} where {due} was due"
        )

    def _off(self, since: _Count, count: _Count) -> float:
        """Return the half cycles by which a count is off, beyond what a line drifts meanwhile."""
        passed = self._passed(since, count)
        off = (count[0] - since[0] - passed) % self._modulus
        return min(off, self._modulus - off) - _DRIFT * abs(passed)

    def _passed(self, since: _Count, count: _Count) -> float:
        """Return the half cycles between the arrivals of two counts."""
        return (count[1] - since[1]) / self._tick_s
