"""What most ports have in common: counts, answers, delays of a lost bus, the reset of a fault.

No tick commands it: an operator asks for it while the drive is off.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from adaptdrive.devices.binding import Sink
from adaptdrive.devices.port import PortStatistics

# Counts of a port, answers that most ports have in common, and delays of a bus that is lost.

_FIRST_S = 0.1
"""An interface or a server that is restarted is soon back."""

_LONGEST_S = 2.0
"""A cable or an adapter that is plugged in again should not be waited for."""


class CountingPort:
    """Counts of a port, and the answers of a drive whose readings each report the bridge.

    A port overrides what is otherwise with it.
    """

    counter_modulus: int | None = None
    """None: no frame of the drive counts half cycles."""

    stop_slack_s: float | None = 0.0
    bridge_cycle_s = 0.0
    """0: each reading has a report of the bridge."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(**self._counts)

    def take_garbage(self) -> None:
        """Count something on the bus that is no frame, or none of the drive."""
        self._counts["received"] += 1
        self._counts["foreign"] += 1

    def catch_up(self) -> None:
        """Nothing waits: each answer is taken where it was asked for."""

    def rehearse(self) -> None:
        """Not worth it: what a reading costs is little compared with what a tick does."""

    def details(self) -> list[str]:
        """Return no lines: what is refused is announced on its own."""
        return []

    async def reset_fault(self) -> None:
        """No-op: the drive clears its fault word by itself."""


class BusBackoff:
    """Delays that double until the bus has carried something."""

    def __init__(self, heard: Callable[[], int]) -> None:
        """Start with the shortest delay.

        Args:
            heard: Returns the number of frames or replies since the port was built.
        """
        self._heard = heard
        self._before = heard()
        self._delay_s = _FIRST_S

    def next_s(self) -> float:
        """Return the delay before the next attempt, in s; the shortest after any reception."""
        heard = self._heard()
        if heard > self._before:
            self._before, self._delay_s = heard, _FIRST_S
        delay_s, self._delay_s = self._delay_s, min(2.0 * self._delay_s, _LONGEST_S)
        return delay_s


# Reset of a drive's fault by a part of its command: on for a moment, and off again.

_READINGS = 3.0
"""Readings for which each level lasts: a drive that is polled takes one command in each."""

_LEAST_S = 0.1
"""Shortest time of a level: drives look at such a bit every few milliseconds."""


async def pulse_reset(sinks: Iterable[Sink[Any]], reading_s: float) -> None:
    """Switch the reset of a fault on and off with the next commands; nothing where there is none.

    Args:
        sinks: All parts of the command.
        reading_s: Time from one reading of the drive to the next.
    """
    resets = [sink.reset for sink in sinks if sink.reset is not None]
    level_s = max(_LEAST_S, _READINGS * reading_s)
    for level in (True, False) if resets else ():
        try:
            for reset in resets:
                reset.on = level
            await asyncio.sleep(level_s)
        finally:
            for reset in resets:
                reset.on = False
