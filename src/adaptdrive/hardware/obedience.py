"""Judges whether a drive obeys the safe command: one that does not must not be kept from stopping.

How a drive is kept from stopping by itself, by commands or by heartbeats, is a matter of its bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable


class Obedience:
    """Times the safe command in force from when the drive may first have heard it.

    Attributes:
        heard_s: That time by the monotonic clock, infinite while no safe command is in force.
    """

    def __init__(self, limit_s: float, clock: Callable[[], float]) -> None:
        """Note no command yet.

        Args:
            limit_s: Time that the drive has to obey, `Timing.obeyed_s`.
            clock: Monotonic clock, in s.
        """
        self._limit_s = limit_s
        self._clock = clock
        self.heard_s = math.inf

    @property
    def awaited(self) -> bool:
        """True while a safe command is in force."""
        return self.heard_s < math.inf

    def hear(self) -> None:
        """Note that the drive may hear the safe command now; the first time counts."""
        if self.heard_s == math.inf:
            self.heard_s = self._clock()

    def forget(self) -> None:
        """Note another command, or the loss of a bus on which nothing shows what was heard."""
        self.heard_s = math.inf

    def overdue_s(self, *, powered: bool) -> float:
        """Return for how long a drive has not obeyed the safe command, negative while it may yet.

        Args:
            powered: Whether its last report, also one of a link before, has it energised.
        """
        return self._clock() - self.heard_s - self._limit_s if powered else -math.inf
