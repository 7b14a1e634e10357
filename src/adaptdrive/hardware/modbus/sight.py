"""Freshness of what is known of a drive that is commanded on: it may stop by itself at any time."""

from __future__ import annotations

import math
from collections.abc import Callable

from adaptdrive.config.timing import Timing

_LOOK_TIMEOUTS = 0.5
"""Age of a report at which a write still follows, in time-outs besides those of the exchanges."""


class Sight:
    """Times of the last report of a drive's bridge and of the last command that it took.

    Both count from their request: the process may have stood still with the reply in its buffer.
    A drive without such a report shows nothing, and is commanded all the same.

    Attributes:
        limit_s: Time after which a drive that takes no command may have stopped, in s.
    """

    def __init__(
        self, reported: bool, timing: Timing, look_s: float, clock: Callable[[], float]
    ) -> None:
        """See and feed nothing yet.

        Args:
            reported: Whether the drive reports its bridge.
            timing: Times of the drive.
            look_s: Age of a report at which a write still follows it, in s.
            clock: Monotonic clock, in s.
        """
        self._reported = reported
        self.limit_s = timing.silent_s
        self._look_s = look_s
        self._usual_s = timing.usual_s
        # joined now and then, commands would be far apart
        self._each_poll = self.limit_s >= timing.reading_s
        self._clock = clock
        self._seen_s = self._fed_s = -math.inf

    @property
    def fed_s(self) -> float:
        """Time at which the last command that the drive took was sent."""
        return self._fed_s

    @property
    def may_have_timed_out(self) -> bool:
        """True if the drive has taken no command for as long as its own time-out may be."""
        return self._clock() - self._fed_s > self.limit_s

    @property
    def follows_look(self) -> bool:
        """True if what energises may be written: the poll has a report that is still good."""
        age_s = self._clock() - self._seen_s
        fresh = age_s <= self._look_s or not self.may_have_timed_out
        return not self._reported or (age_s < math.inf and fresh)

    @property
    def joins_look(self) -> bool:
        """True if what energises may be written with the read that would show a stop."""
        usual = self._clock() - self._seen_s <= self._usual_s and not self.may_have_timed_out
        return not self._reported or (self._each_poll and usual)

    def feed(self, asked_s: float) -> None:
        """Note a command that the drive has taken.

        Args:
            asked_s: When it was sent, monotonic clock.
        """
        self._fed_s = asked_s

    def look(self, asked_s: float) -> None:
        """Note a report of the bridge, on or off.

        Args:
            asked_s: When it was asked for, monotonic clock.
        """
        self._seen_s = asked_s

    def forget(self) -> None:
        """Begin a poll: reports of the one before do not count for its commands."""
        self._seen_s = -math.inf


def look_limit_s(timeout_s: float, writes: int) -> float:
    """Return the age of a report at which a write still follows it, in s.

    It is that of a drive that answers the read, and each write before the last, just in time.

    Args:
        timeout_s: Longest time from a request to its reply, in s.
        writes: Writes that make one command.
    """
    return (writes + _LOOK_TIMEOUTS) * timeout_s
