"""Deadlines, kept by the kernel and delivered in the event loop: one at a time, or on a grid."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from adaptdrive.clock.now import now_s
from adaptdrive.clock.timerfd import acknowledge, arm_timer, create_timer


class TickTimer:
    """Calls back at an absolute time of the daemon's clock; arming again replaces the deadline."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        callback: Callable[[float], None],
        spin_s: float = 0.0,
    ) -> None:
        """Open the timer.

        Args:
            loop: Event loop to call back in.
            callback: Called with the deadline that has passed.
            spin_s: Wake up so much earlier, and wait for the deadline without giving up the CPU.
        """
        self._loop = loop
        self._callback = callback
        self._spin_s = spin_s
        self._deadline_s = 0.0
        self._descriptor = create_timer()
        loop.add_reader(self._descriptor, self._expired)

    def arm(self, deadline_s: float) -> None:
        """Call back at `deadline_s`, at once when it is past."""
        self._deadline_s = deadline_s
        arm_timer(self._descriptor, deadline_s - self._spin_s)

    def close(self) -> None:
        """Never call back again."""
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            os.close(self._descriptor)
            self._descriptor = -1

    def _expired(self) -> None:
        if not acknowledge(self._descriptor):
            return  # armed anew since it woke the loop: by a frame that came in the same round
        while now_s() < self._deadline_s:
            pass
        self._callback(self._deadline_s)


@contextmanager
def pulsing(period_s: float, *due: Callable[[], object]) -> Iterator[None]:
    """Call back on a grid until the block ends; deadlines that the process slept over are skipped.

    Args:
        period_s: Time from one call to the next, in s; the first is one period away.
        due: Called each time, in this order; must return at once.
    """

    def expired(deadline_s: float) -> None:
        skipped = max(0, int((now_s() - deadline_s) / period_s))
        timer.arm(deadline_s + (1 + skipped) * period_s)
        for call in due:
            call()

    timer = TickTimer(asyncio.get_running_loop(), expired)
    if due:
        timer.arm(now_s() + period_s)
    try:
        yield
    finally:
        timer.close()
