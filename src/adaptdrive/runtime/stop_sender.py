"""Safe commands outside of ticks: on each stop, and repeatedly when the daemon ends."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Callable

from adaptdrive.devices.port import FAREWELL_GAP_S, FAREWELLS
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import State

_STOP_GAP_S = 0.004
"""Least time between the safe commands of a flood of stops: half a tick, for the bus's sake."""


class StopSender:
    """Brings one drive into its safe state."""

    def __init__(self, machine: Machine, fast: FastLoop, clock: Callable[[], float]) -> None:
        """Send nothing yet.

        Args:
            machine: The state machine.
            fast: Sends the commands.
            clock: Monotonic clock in seconds.
        """
        self._machine = machine
        self._fast = fast
        self._clock = clock
        self._stopped_s = -math.inf

    def stop(self) -> None:
        """Send only safe commands from now on, and the first one at once."""
        self._machine.disable()
        self._fast.send_safe()

    def stop_again(self) -> None:
        """Do the same for one of many requests; a flood of them does not fill the bus."""
        now_s = self._clock()
        if self._machine.energised or now_s - self._stopped_s >= _STOP_GAP_S:
            self.stop()
            self._stopped_s = now_s

    async def await_stop(self) -> None:
        """Send safe commands until the drive confirms its stop, or has had the time to."""
        end_s = self._clock() + self._fast.stop_limit_s + FAREWELL_GAP_S
        for number in itertools.count():
            late = self._clock() > end_s  # judged once more then, however long this process slept
            self._fast.send_safe()
            ended = late or self._machine.state is not State.STOPPING
            if ended and number >= FAREWELLS:
                break
            await asyncio.sleep(FAREWELL_GAP_S)

    async def say_farewell(self) -> None:
        """Stop the drive more than once: a frame can be lost."""
        for _ in range(FAREWELLS):
            self.stop()
            await asyncio.sleep(FAREWELL_GAP_S)
