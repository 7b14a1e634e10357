"""Reports from the runtime to everyone else, through queues that can never block it.

Each subscriber has its own bounded queue. A full queue drops its oldest report and counts the
drop, so that a stalled broker or disk costs history and never a tick.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence

from adaptdrive.runtime.reports import Report


class Subscription:
    """One subscriber's queue."""

    def __init__(self, kinds: tuple[type[Report], ...], size: int) -> None:
        self.kinds = kinds
        self.dropped = 0
        self._queue: deque[Report] = deque(maxlen=size)
        self._ready = asyncio.Event()

    def offer(self, report: Report) -> None:
        """Append a report; the oldest one goes when the queue is full."""
        if len(self._queue) == self._queue.maxlen:
            self.dropped += 1
        self._queue.append(report)
        self._ready.set()

    async def take(self) -> Sequence[Report]:
        """Wait until there is at least one report, then take all there are."""
        await self._ready.wait()
        return self.drain()

    def drain(self) -> Sequence[Report]:
        """Take all there are, maybe none, without waiting."""
        self._ready.clear()
        taken = tuple(self._queue)
        self._queue.clear()
        return taken


class Hub:
    """Hands each report to every subscriber of its kind."""

    def __init__(self) -> None:
        self._queues: dict[type[Report], list[Subscription]] = {}

    def subscribe(self, *kinds: type[Report], size: int) -> Subscription:
        """Open a queue for the given kinds of report.

        Args:
            kinds: Report classes.
            size: Reports held before the oldest is dropped.
        """
        subscription = Subscription(kinds, size)
        for kind in kinds:
            self._queues.setdefault(kind, []).append(subscription)
        return subscription

    def publish(self, report: Report) -> None:
        """Offer a report to its subscribers. Never blocks, never fails."""
        for subscription in self._queues.get(type(report), ()):
            subscription.offer(report)
