"""Delay before a lost bus is opened again."""

from __future__ import annotations

_FIRST_S = 0.1
"""An interface or a server that is restarted is soon back."""

_LONGEST_S = 2.0
"""A cable or an adapter that is plugged in again should not be waited for."""


class BusBackoff:
    """Waits that double, until the bus has been of use."""

    def __init__(self) -> None:
        self._wait_s = _FIRST_S

    def next_s(self) -> float:
        """The wait before the next attempt."""
        wait_s, self._wait_s = self._wait_s, min(2.0 * self._wait_s, _LONGEST_S)
        return wait_s

    def reset(self) -> None:
        """The bus has carried something."""
        self._wait_s = _FIRST_S
