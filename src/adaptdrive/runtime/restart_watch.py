"""Notices a drive that has started anew by its half-cycle counter: it must not be driven on.

A drive may start anew so quickly that no reading is missed for long, and the commands of that time
have switched it on again before its first report. Its count then begins at 0.

A count that keeps step with time is that of the drive as it was, whatever was lost and however
often it has wrapped. One that does not, and that may have begun at 0 since the frame before, is in
doubt. If the frames after it keep step with that from before, it was late, or repeated; frames that
waited come at once and are soon over. If they keep step with the doubtful one alone, the drive has
started anew.

A count that fits neither may be that of an old frame. It changes nothing, unless those after it
keep step with it: the counter has jumped. Nor does one that stands, or that is older.
"""

from __future__ import annotations

_SLACK_TICKS = 3.0
"""Permitted difference of count and time, in half cycles, for jitter of the arrival."""

_DRIFT = 0.04
"""The same per half cycle that passes: line and measured half cycle may be 2 % off each."""

_BEGUN_TICKS = 6.0
"""The same of a count that began at 0 after the frame before, which may have been late itself."""

_PACE_TICKS = 1.0
"""Difference within which the frames after a doubtful one keep step with it."""

_SURE_TICKS = 2.5
"""Half cycles after a doubtful frame at which frames that had waited are over."""

_Count = tuple[int, float]
"""The count of a frame, and its arrival by the monotonic clock."""


class RestartWatch:
    """Finds a drive whose half-cycle counter has begun anew."""

    def __init__(self, modulus: int | None, tick_s: float) -> None:
        """Start without a frame.

        Args:
            modulus: Where the drive's counter wraps, None for a drive without one.
            tick_s: Half a line cycle at nominal frequency.
        """
        self._modulus = modulus or 1
        self._tick_s = tick_s
        self._last: _Count | None = None
        self._before: _Count | None = None
        self._stray: _Count | None = None
        self._cause: str | None = None

    @property
    def in_doubt(self) -> bool:
        """True while the drive may have started anew."""
        return self._before is not None or self._cause is not None

    def see(self, counter: int | None, arrival_s: float, tick_s: float) -> None:
        """Take the count of a reading.

        Args:
            counter: The drive's counter as sent.
            arrival_s: Arrival of the reading, monotonic clock.
            tick_s: Half a line cycle as measured.
        """
        if counter is None:
            return
        self._tick_s = tick_s
        count, last, before = (counter, arrival_s), self._last, self._before
        if last is None:
            self._last = count
        elif self._off(before or last, count) <= _SLACK_TICKS:
            self._follow(before or last, count)
        elif before is None or self._off(last, count) > _PACE_TICKS:
            self._doubt(before or last, count)
        elif self._passed(last, count) >= _SURE_TICKS:
            self._settle(before, last)

    def find_cause(self, *, commanded: bool) -> str | None:
        """Return the cause of a trip, None for none.

        Args:
            commanded: Whether the last command had the bridge on; else a drive may start anew.
        """
        if not commanded:
            self._before = self._cause = None
        return self._cause

    def _follow(self, since: _Count, count: _Count) -> None:
        """Take a count that keeps step for that of the drive as it was, if it is a newer one."""
        if (since[0] - count[0]) % self._modulus > _SLACK_TICKS:
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
