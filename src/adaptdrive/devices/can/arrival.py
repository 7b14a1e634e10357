"""Arrival time of a frame at the machine, by the monotonic clock.

The kernel stamps a frame with the wall clock, which may be set while the frame waits to be read.
The offset between both clocks is measured at each frame. No frame has waited since before its
queue was last found empty: however long that is, and whatever its stamp is. Where the wall clock
was set meanwhile, each frame that is read until the queue is empty counts as that old.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import can

PROMPT_S = 0.002
"""A clocking frame that has waited for less than this has no successor yet: half cycles last."""

_STEP_S = 0.001
"""Change of the offset from one frame to the next that is a step: slewing by NTP changes it by 5 µs
in 10 ms."""

_LOOKS = 3
"""Attempts to read both clocks without being interrupted for `_STEP_S` between them."""


class ArrivalClock:
    """Converts the stamps of frames from the wall clock to the monotonic clock."""

    def __init__(
        self, clock: Callable[[], float], wall_clock: Callable[[], float] = time.time
    ) -> None:
        """Measure the offset between both clocks.

        Args:
            clock: Monotonic clock, in seconds.
            wall_clock: The clock with which the bus stamps frames, in seconds.
        """
        self._clock = clock
        self._wall_clock = wall_clock
        self._empty_s, self._offset_s = self._look()
        self._drain_s = self._empty_s
        self._stepped = False

    def begin_drain(self) -> None:
        """Note that the queue is about to be opened, or read until it is empty."""
        self._drain_s = self._clock()

    def end_drain(self) -> None:
        """Note that the queue is empty; what comes now came after its reading began."""
        self._empty_s = self._drain_s
        self._stepped = False

    def waited_s(self, frame: can.Message) -> float:
        """Return for how long a frame has waited to be read, 0 where that is not known.

        A frame that waited while the loop was busy must not look as fresh as one that was read at
        once.
        """
        if not frame.timestamp:
            return 0.0
        now_s, offset_s = self._look()
        self._stepped = self._stepped or abs(offset_s - self._offset_s) > _STEP_S
        self._offset_s = offset_s
        longest_s = now_s - self._empty_s
        if self._stepped:
            return longest_s
        return min(max(now_s - (frame.timestamp - offset_s), 0.0), longest_s)

    def _look(self) -> tuple[float, float]:
        """Return the monotonic time, and how far the wall clock is ahead of it."""
        for _ in range(_LOOKS):
            before_s = self._clock()
            wall_s = self._wall_clock()
            now_s = self._clock()
            if now_s - before_s < _STEP_S:
                break
        return now_s, wall_s - now_s
