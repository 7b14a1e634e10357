"""Reports from the runtime to everyone else, through queues that can never block it.

Each subscriber has its own bounded queue. A full queue drops its oldest report and counts the
drop, so that a stalled broker or disk costs history and never a tick.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from typing import Generic, TypeVar

from adaptdrive.runtime.reports import Report

T = TypeVar("T")


class Bounded(Generic[T]):
    """A queue between two tasks; the oldest goes when it is full.

    Attributes:
        dropped: Items that went because the queue was full.
        limit: Most items that wait.
    """

    def __init__(self, limit: int) -> None:
        self.dropped = 0
        self.limit = limit
        self._items: deque[T] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Leave an item; returns at once."""
        self._items.append(item)
        self._filled.set()
        if len(self._items) > self.limit:
            self._items.popleft()
            self.dropped += 1

    def drain(self) -> Sequence[T]:
        """Take all there are, maybe none, without waiting."""
        self._filled.clear()
        taken = tuple(self._items)
        self._items.clear()
        return taken


class Subscription(Bounded[Report]):
    """One subscriber's queue."""

    async def take(self) -> Sequence[Report]:
        """Wait until there is at least one report, then take all there are."""
        await self._filled.wait()
        return self.drain()


Keep = Callable[[], Awaitable[None]]
"""Waits until all that was published is in a file, for a short bounded time at most."""


async def _wait_for_nothing() -> None:
    pass


class Hub:
    """Hands each report to every subscriber of its kind.

    Attributes:
        kept: Waits until all that was published so far is recorded; at once where nothing is.
            Subscribers call it before an event leaves the process, so that no kill can leave an
            event with an operator and not in the session. A disk that hangs delays it by a bounded
            time.
    """

    def __init__(self) -> None:
        self._queues: dict[type[Report], list[Subscription]] = {}
        self.kept: Keep = _wait_for_nothing

    def subscribe(self, *kinds: type[Report], size: int) -> Subscription:
        """Open a queue for the given kinds of report.

        Args:
            kinds: Report classes.
            size: Reports held before the oldest is dropped.
        """
        subscription = Subscription(size)
        for kind in kinds:
            self._queues.setdefault(kind, []).append(subscription)
        return subscription

    def publish(self, report: Report) -> None:
        """Offer a report to its subscribers. Never blocks, never fails."""
        for subscription in self._queues.get(type(report), ()):
            subscription.put(report)
