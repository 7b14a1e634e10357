"""Counts of a port, and answers that most drives have in common."""

from __future__ import annotations

from collections import Counter

from adaptdrive.hardware.port import PortStatistics


class CountingPort:
    """A port of a drive without a counter, each of whose readings reports the bridge.

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

    def catch_up(self) -> None:
        """Nothing waits: each answer is taken where it was asked for."""

    def rehearse(self) -> None:
        """Not worth it: what a reading costs is little compared with what a tick does."""

    def details(self) -> list[str]:
        """Return no lines: what is refused is announced on its own."""
        return []

    async def reset_fault(self) -> None:
        """No-op: the drive clears its fault word by itself."""

    def take_garbage(self) -> None:
        """Count something on the bus that is no frame."""
        self._counts["received"] += 1
        self._counts["foreign"] += 1
