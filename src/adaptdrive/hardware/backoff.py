"""Delay before a lost bus is opened again."""

from __future__ import annotations

from collections.abc import Callable

_FIRST_S = 0.1
"""An interface or a server that is restarted is soon back."""

_LONGEST_S = 2.0
"""A cable or an adapter that is plugged in again should not be waited for."""


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
