"""Arrival time of a frame at the machine, by the monotonic clock.

The kernel stamps a frame with the wall clock, which may be set while the frame waits to be read.
The offset between both clocks is measured at each frame. A frame that was stamped before the wall
clock was set is converted with the offset from before. No frame has waited since before its queue
was last found empty: however long that is, and whatever its stamp is.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

import can

PROMPT_S = 0.002
"""A clocking frame that has waited for less than this has no successor yet: half cycles last."""

_STEP_S = 0.001
"""Change of the offset from one frame to the next that is a step: slewing by NTP changes it by 5 µs
in 10 ms."""

_LOOKS = 3
"""Attempts to read both clocks without being interrupted for `_STEP_S` between them."""

_STEPS = 4
"""Steps of the wall clock since the queue was empty that are remembered."""


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
        self._former: deque[tuple[float, float]] = deque(maxlen=_STEPS)
        self._offset_s = self._look()[1]
        self._drain_s = -math.inf
        self._empty_s = -math.inf

    def begin_drain(self) -> None:
        """Note that the queue is about to be opened, or read until it is empty."""
        self._drain_s = self._clock()

    def end_drain(self) -> None:
        """Note that the queue is empty; what comes now came after its reading began."""
        self._empty_s = self._drain_s

    def waited_s(self, frame: can.Message) -> float:
        """Return for how long a frame has waited to be read, 0 where that is not known.

        A frame that waited while the loop was busy must not look as fresh as one that was read at
        once.
        """
        if not frame.timestamp:
            return 0.0
        now_s, offset_s = self._look()
        if abs(offset_s - self._offset_s) > _STEP_S:
            self._former.append((self._offset_s, now_s))
        self._offset_s = offset_s
        wait_s = now_s - (frame.timestamp - offset_s)
        if self._former:
            wait_s = self._shortest_s(wait_s, frame.timestamp, now_s)
        return min(max(wait_s, 0.0), now_s - self._empty_s)

    def _shortest_s(self, wait_s: float, timestamp_s: float, now_s: float) -> float:
        """Return the shortest wait that is possible with the offsets since the queue was empty."""
        former = [offset_s for offset_s, until_s in self._former if until_s >= self._empty_s]
        waits_s = [wait_s, *(now_s - (timestamp_s - offset_s) for offset_s in former)]
        return min((one_s for one_s in waits_s if one_s > -_STEP_S), default=0.0)

    def _look(self) -> tuple[float, float]:
        """Return the monotonic time, and how far the wall clock is ahead of it."""
        for _ in range(_LOOKS):
            before_s = self._clock()
            wall_s = self._wall_clock()
            now_s = self._clock()
            if now_s - before_s < _STEP_S:
                break
        return now_s, wall_s - now_s
