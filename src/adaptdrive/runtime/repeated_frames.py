"""Recognition of old frames of a drive that counts its half cycles, by their counts.

A drive that hangs, or a gateway, may repeat its last frame for ever, or several of them in turn:
these advance from one to the next, and back. A count that stands, or is behind the newest one, is
therefore that of an old frame. A count that has leapt elsewhere, as of a drive that starts anew, is
the newest once it has advanced from there for a time: longer than a reading may be old if it has
leapt back. That of a drive that starts anew at 0 is so at once.
"""

from __future__ import annotations

import math

SLACK_TICKS = 3
"""Permitted difference of counter and elapsed time, in half cycles, for jitter of the arrival."""

_OLDER_SHARE = 0.25
"""Share of its range by which a repeated count is older than the newest, at the most."""

_ANEW_TICKS = 7.5
"""Half cycles that a counter must keep advancing before a jump is accepted."""

_ANEW_SHARE = 1.1
"""The same as a share of the longest age of a reading, of one that has leapt back: frames that are
repeated in turn, however many they are, have stood for longer by then."""

_BOOT_TICKS = 60
"""Half cycles from one leap to the next between which a drive cannot have started anew: 0.5 s."""

_RESTART_TICKS = 2 * SLACK_TICKS
"""Half cycles that a count near 0 is behind the newest where the drive has started anew: frames in
the wrong order are behind by less."""


class RepeatedFrames:
    """Compares the count of each frame with the newest one."""

    def __init__(self, modulus: int, nominal_tick_s: float, stale_s: float) -> None:
        """Start without a frame.

        Args:
            modulus: Where the drive's counter wraps.
            nominal_tick_s: Half cycle at nominal line frequency.
            stale_s: Longest age of a reading.
        """
        self._modulus = modulus
        self._anew_ticks = max(_ANEW_TICKS, _ANEW_SHARE * stale_s / nominal_tick_s - 0.5)
        self._last: tuple[int, float] | None = None
        self._newest = 0, -math.inf
        self._risen_s = self._leapt_s = -math.inf
        self._anew = False

    def is_old(self, count: int, arrival_s: float, tick_s: float) -> bool:
        """Return whether a frame is an old one.

        Args:
            count: The drive's counter as sent.
            arrival_s: Arrival of the frame, monotonic clock.
            tick_s: Half cycle as measured.
        """
        frame = count, arrival_s
        last, self._last = self._last, frame
        if last is None:
            self._newest = frame
            return False
        if not self._may_follow(last, count, arrival_s, tick_s):
            self._risen_s = arrival_s
            self._leap(last, count, arrival_s, tick_s)
        is_behind = self._is_behind(last[1], count, arrival_s, tick_s)
        in_time = not is_behind and self._may_follow(self._newest, count, arrival_s, tick_s)
        risen = (arrival_s - self._risen_s) / tick_s
        if in_time or risen >= (self._anew_ticks if is_behind else _ANEW_TICKS):
            self._newest = frame
            return False
        return is_behind

    def _is_behind(self, last_s: float, count: int, arrival_s: float, tick_s: float) -> bool:
        """Return whether a count is behind the newest one.

        One that had time to come round is not, nor is that of a drive that has started anew.
        """
        behind = (self._newest[0] - count) % self._modulus
        may_wrap = (arrival_s - last_s) / tick_s >= 0.5 * self._modulus
        if may_wrap or (self._anew and behind > _RESTART_TICKS):
            return False
        return behind < _OLDER_SHARE * self._modulus

    def _leap(self, last: tuple[int, float], count: int, arrival_s: float, tick_s: float) -> None:
        """Note whether a count that does not follow the last one is that of a drive started anew.

        It may have begun at 0 since then. Frames that are repeated in turn leap back to the oldest
        of them, and soon again; those in the wrong order leap back by less.
        """
        if (last[0] - count) % self._modulus <= _RESTART_TICKS:
            return
        begins = count <= (arrival_s - last[1]) / tick_s + SLACK_TICKS
        self._anew = begins and (arrival_s - self._leapt_s) / tick_s > _BOOT_TICKS
        self._leapt_s = arrival_s

    def _may_follow(
        self, earlier: tuple[int, float], count: int, arrival_s: float, tick_s: float
    ) -> bool:
        """Return whether a count can come after another: it does not advance faster than time."""
        ahead = (count - earlier[0]) % self._modulus
        return 0 < ahead <= (arrival_s - earlier[1]) / tick_s + SLACK_TICKS
