"""Whether a sensor bus is there, told when that changes."""

from __future__ import annotations

from adaptdrive.hardware.port import SensorListener


class Presence:
    """What a listener was last told of one sensor bus.

    Args:
        description: The bus in one phrase for people.
    """

    def __init__(self, description: str) -> None:
        self._description = description
        self._up: bool | None = None

    @property
    def known(self) -> bool:
        """Whether the bus has been there, or missed, before."""
        return self._up is not None

    def tell(self, listener: SensorListener, *, up: bool, problem: str = "") -> None:
        """Tell of a change; that everything is well at the start is no news."""
        if up is self._up:
            return
        news, self._up = self.known or not up, up
        if news:
            detail = self._description if up else f"{self._description}: {problem}"
            listener.on_bus(up=up, detail=detail)
