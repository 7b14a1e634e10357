"""Counts of a port, answers that most drives have in common, and the presence of a bus.

A lost bus is opened again after a delay.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from adaptdrive.hardware.port import Listener, PortStatistics, SensorListener

_FIRST_S = 0.1
"""An interface or a server that is restarted is soon back."""

_LONGEST_S = 2.0
"""A cable or an adapter that is plugged in again should not be waited for."""


class CountedPort:
    """Counts of a port."""

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


class CountingPort(CountedPort):
    """A port of a drive without a counter, each of whose readings reports the bridge.

    A port overrides what is otherwise with it.
    """

    counter_modulus: int | None = None
    """None: no frame of the drive counts half cycles."""

    stop_slack_s: float | None = 0.0
    bridge_cycle_s = 0.0
    """0: each reading has a report of the bridge."""

    def catch_up(self) -> None:
        """Nothing waits: each answer is taken where it was asked for."""

    def rehearse(self) -> None:
        """Not worth it: what a reading costs is little compared with what a tick does."""

    def details(self) -> list[str]:
        """Return no lines: what is refused is announced on its own."""
        return []

    async def reset_fault(self) -> None:
        """No-op: the drive clears its fault word by itself."""


class SensingPort(CountedPort):
    """The part of a port that is the same for sensors on each kind of bus and for a polled drive.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(self, description: str) -> None:
        super().__init__()
        self.description = description
        self._up: bool | None = None

    def _count_reopened(self) -> None:
        """Count a bus that is open, unless it is so for the first time."""
        self._counts["reconnects"] += self._up is not None

    def _report(self, listener: Listener | SensorListener, *, up: bool, problem: str = "") -> None:
        """Report a change of presence; a bus that is present at the start is none."""
        if up is self._up:
            return
        news, self._up = self._up is not None or not up, up
        if news:
            detail = self.description if up else f"{self.description}: {problem}"
            listener.on_bus(up=up, detail=detail)


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
