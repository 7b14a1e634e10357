"""Reports from the runtime to everyone else, through queues that can never block it.

Each subscriber has its own bounded queue. A full queue drops its oldest report and counts the
drop, so that a stalled broker or disk costs history and never a tick.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence

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


Keep = Callable[[], Awaitable[None]]
"""Waits until all that was published is in a file, for a short bounded time at most."""


class Hub:
    """Hands each report to every subscriber of its kind."""

    def __init__(self) -> None:
        self._queues: dict[type[Report], list[Subscription]] = {}
        self._keep: Keep = _wait_for_nothing

    def keep_with(self, keep: Keep) -> None:
        """Name the recorder of what is published.

        Args:
            keep: Waits for the recorder.
        """
        self._keep = keep

    async def kept(self) -> None:
        """Wait until all that was published so far is recorded; at once where nothing is.

        Subscribers call it before an event leaves the process, so that no kill can leave an event
        with an operator and not in the session. A disk that hangs delays it by a bounded time.
        """
        await self._keep()

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


async def _wait_for_nothing() -> None:
    pass
