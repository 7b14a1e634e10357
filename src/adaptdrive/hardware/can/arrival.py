"""How long a frame has waited to be read."""

from __future__ import annotations

from collections.abc import Callable

import can

OLDEST_S = 1.0
"""Longest time that a frame is believed to have waited to be read. The waiting time is measured
with the wall clock, and a step of that clock must not send an arrival into the distant past."""

PROMPT_S = 0.002
"""A clocking frame that has waited for less than this has no successor yet: half cycles last."""


def waiting_time_s(frame: can.Message, wall_clock: Callable[[], float]) -> float:
    """How long ago a frame reached the machine, 0 where that is not known.

    The kernel stamps frames when they arrive: one that waited while the loop was busy must not look
    as fresh as one that was read at once.

    Args:
        frame: The frame.
        wall_clock: The clock with which the bus stamps frames, in seconds.
    """
    if not frame.timestamp:
        return 0.0
    return max(wall_clock() - frame.timestamp, 0.0)
