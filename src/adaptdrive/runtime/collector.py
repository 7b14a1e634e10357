"""Garbage collection between ticks."""

from __future__ import annotations

import gc

COLLECT_TICKS = 240
"""Ticks between two collections: one in two seconds."""

_MIDDLE_EVERY = 10
"""Collections of the youngest objects to one of the middle ones: the ratio of Python's own."""

_FULL_EVERY = 300
"""Least collections between two full ones: each takes 10 ms and more, even with the drive off."""


class IdleCollector:
    """Collects garbage in the slack after a tick, in place of Python's own bad moments.

    While a drive runs, only young objects are looked at: a full collection takes as long as
    everything that lives is large, ten milliseconds and more with many commands remembered. It
    waits until the drive is off.
    """

    def __init__(self, every_ticks: int) -> None:
        """Collect nothing yet.

        Args:
            every_ticks: Ticks from one collection to the next; 0 for never.
        """
        self._every = every_ticks
        self._waited = 0
        self._collections = 0
        self._since_full = 0

    def is_due(self) -> bool:
        """Count a tick; whether a collection is due after it."""
        self._waited += 1
        if not self._every or self._waited < self._every:
            return False
        self._waited = 0
        return True

    def collect(self, *, idle: bool) -> int:
        """Collect what became garbage since the freeze.

        Args:
            idle: Whether the drive is off, so that a late tick does no harm.

        Returns:
            The generation that was collected.
        """
        self._collections += 1
        self._since_full += 1
        generation = 0 if self._collections % _MIDDLE_EVERY else 1
        if idle and self._since_full >= _FULL_EVERY:
            self._since_full, generation = 0, 2
        gc.collect(generation)
        return generation
