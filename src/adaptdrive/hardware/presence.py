"""Presence of a sensor bus, reported at each change."""

from __future__ import annotations

from adaptdrive.hardware.port import SensorListener


class Presence:
    """Last report on one sensor bus to a listener.

    Args:
        description: The bus in one phrase.
    """

    def __init__(self, description: str) -> None:
        self._description = description
        self._up: bool | None = None

    @property
    def known(self) -> bool:
        """True if the bus was reported present or missing before."""
        return self._up is not None

    def report(self, listener: SensorListener, *, up: bool, problem: str = "") -> None:
        """Report a change; a bus that is present at the start is none."""
        if up is self._up:
            return
        news, self._up = self.known or not up, up
        if news:
            detail = self._description if up else f"{self._description}: {problem}"
            listener.on_bus(up=up, detail=detail)
