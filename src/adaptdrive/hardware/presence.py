"""Counts and presence of a sensor bus, which every port of one reports."""

from __future__ import annotations

from collections import Counter

from adaptdrive.hardware.port import PortStatistics, SensorListener


class SensingPort:
    """The part of a port of sensors that is the same on each kind of bus.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(self, description: str) -> None:
        self.description = description
        self._counts: Counter[str] = Counter()
        self._up: bool | None = None

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(**self._counts)

    def _count_reopened(self) -> None:
        """Count a bus that is open, unless it is so for the first time."""
        self._counts["reconnects"] += self._up is not None

    def _report(self, listener: SensorListener, *, up: bool, problem: str = "") -> None:
        """Report a change of presence; a bus that is present at the start is none."""
        if up is self._up:
            return
        news, self._up = self._up is not None or not up, up
        if news:
            detail = self.description if up else f"{self.description}: {problem}"
            listener.on_bus(up=up, detail=detail)
