"""SYNC from the daemon: one each half line cycle, on an absolute grid."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from adaptdrive.clock.tick_timer import TickTimer


class SyncProducer:
    """Calls back on a grid; deadlines missed while the process slept are skipped, not repeated."""

    def __init__(
        self, period_s: float, clock: Callable[[], float], due: Callable[[], None]
    ) -> None:
        """Set the grid.

        Args:
            period_s: Time between two SYNCs.
            clock: Monotonic clock in seconds.
            due: Called when a SYNC is due; must return at once.
        """
        self._period_s = period_s
        self._clock = clock
        self._due = due
        self._timer: TickTimer | None = None

    def start(self) -> None:
        """Begin a grid now."""
        self._timer = TickTimer(asyncio.get_running_loop(), self._expired)
        self._timer.arm(self._clock() + self._period_s)

    def stop(self) -> None:
        """Call back no more."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def _expired(self, deadline_s: float) -> None:
        if self._timer is None:
            return
        skipped = max(0, int((self._clock() - deadline_s) / self._period_s))
        self._timer.arm(deadline_s + (1 + skipped) * self._period_s)
        self._due()
