"""Work shortly before the drive's next frame, which shortens its tick."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from adaptdrive.clock.tick_timer import TickTimer


class FrameWatch:
    """Looks at the bus again and again from shortly before a frame is due until it has come.

    There is then nothing to wake up from.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        look: Callable[[], None],
        spin_s: float,
        clock: Callable[[], float],
    ) -> None:
        """Expect nothing yet.

        Args:
            loop: Event loop of the port.
            look: Passes arrived frames on; the receiver of a frame calls `expect` again.
            spin_s: How long before a frame is due the wait begins, and after it ends.
            clock: Monotonic clock in seconds.
        """
        self._look = look
        self._spin_s = spin_s
        self._clock = clock
        self._due_s = math.nan
        self._timer = TickTimer(loop, self._wait)

    def expect(self, due_s: float) -> None:
        """Wait for a frame that is due at a monotonic time."""
        self._due_s = due_s
        self._timer.arm(due_s - self._spin_s)

    def close(self) -> None:
        """Wait for nothing any more."""
        self._timer.close()

    def _wait(self, _: float) -> None:
        due_s = self._due_s
        while self._due_s == due_s and self._clock() < due_s + self._spin_s:
            self._look()


class DressRehearsal:
    """Rehearses a tick shortly before a frame is due: the CPU's caches then hold what it needs.

    Of all the time that a tick takes after a sleep, most is spent waiting for memory.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        rehearse: Callable[[], None],
        look: Callable[[], None],
        report_end: Callable[[str], None],
        lead_s: float,
    ) -> None:
        """Expect nothing yet.

        Args:
            loop: Event loop of the port.
            rehearse: Does what a tick does, and nothing that can be noticed.
            look: Reads the bus after it, which has no frame yet.
            report_end: Receives the error of a rehearsal that fails, which is the last one.
            lead_s: How long before a frame is due.
        """
        self._rehearse = rehearse
        self._look = look
        self._report_end = report_end
        self._lead_s = lead_s
        self._timer = TickTimer(loop, self._expired)
        self._ended = False

    def expect(self, due_s: float) -> None:
        """Rehearse for a frame that is due at a monotonic time."""
        if not self._ended:
            self._timer.arm(due_s - self._lead_s)

    def close(self) -> None:
        """Rehearse no more."""
        self._ended = True
        self._timer.close()

    def _expired(self, _: float) -> None:
        """Rehearse, and read the bus; no rehearsal that fails is worth a drive that stops."""
        try:
            self._rehearse()
        except Exception as problem:  # noqa: BLE001 - without it ticks only take longer
            self.close()
            self._report_end(repr(problem))
        self._look()
