"""How often something may happen, and how long to wait before trying again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from adaptdrive.operation.clock import Monotonic


@dataclass(slots=True)
class Pace:
    """Keeps at least `interval_s` between two turns.

    Attributes:
        interval_s: Shortest time between two turns.
        monotonic: Clock.
        due_s: When the next turn may be, on that clock.
    """

    interval_s: float
    monotonic: Monotonic
    due_s: float = 0.0

    async def wait(self) -> None:
        """Wait for the next turn and take it."""
        await asyncio.sleep(max(0.0, self.due_s - self.monotonic()))
        self.due_s = self.monotonic() + self.interval_s


@dataclass(slots=True)
class Backoff:
    """Waiting times between attempts: doubling, capped, and spread so that a site does not surge.

    Attributes:
        uniform: Returns a random number between its two arguments.
        first_s: Longest wait after the first failure.
        longest_s: Longest wait at all.
        healthy_s: A connection that lived this long starts the count anew.
        failures: Failures in a row so far.
    """

    uniform: Callable[[float, float], float]
    first_s: float = 0.5
    longest_s: float = 30.0
    healthy_s: float = 10.0
    failures: int = 0

    def after(self, lived_s: float) -> float:
        """The wait, in seconds, after a connection that lived `lived_s` (0 for a failed one)."""
        self.failures = 0 if lived_s >= self.healthy_s else self.failures
        ceiling_s = min(self.longest_s, self.first_s * 2.0 ** min(self.failures, 30))
        self.failures += 1
        return self.uniform(0.5 * ceiling_s, ceiling_s)
