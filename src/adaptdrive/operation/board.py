"""Reports to publish: the present state, and telemetry that was not published yet."""

from __future__ import annotations

import asyncio
from collections import deque
from datetime import datetime
from typing import Generic, TypeVar

from adaptdrive.operation.clock import Synchronisation, WallClock
from adaptdrive.operation.messages import LastTrip, Payload, Standing, state_message
from adaptdrive.operation.profile import Profile
from adaptdrive.runtime.reports import State, StateReport
from adaptdrive.runtime.trips import remedy

T = TypeVar("T")


class Mailbox(Generic[T]):
    """A bounded queue between two tasks; the oldest goes when it is full.

    Attributes:
        dropped: Items that went because the queue was full.
    """

    def __init__(self, size: int) -> None:
        self.dropped = 0
        self._items: deque[T] = deque(maxlen=size)
        self._filled = asyncio.Event()

    def put(self, item: T) -> None:
        """Leave an item."""
        self.dropped += len(self._items) == self._items.maxlen
        self._items.append(item)
        self._filled.set()

    async def take(self) -> T:
        """Wait for the oldest item and take it."""
        await self._filled.wait()
        item = self._items.popleft()
        if not self._items:
            self._filled.clear()
        return item

    def clear(self) -> None:
        """Throw everything away."""
        self._items.clear()
        self._filled.clear()


class StateBoard:
    """The state as operators see it; its time moves only when something else does."""

    def __init__(self, wall: WallClock, profile: Profile, last_trip: LastTrip | None) -> None:
        """Begin without a report.

        Args:
            wall: Wall clock in UTC.
            profile: Name, unit and limits of the drive.
            last_trip: The last trip of an earlier run, None before the first.
        """
        self._wall = wall
        self._last_trip = last_trip
        self._profile = profile
        self._report: StateReport | None = None
        self._clock = Synchronisation.UNKNOWN
        self._since: datetime = wall()
        self._changed_at = self._since
        self._changed = asyncio.Event()

    @property
    def state(self) -> State | None:
        """State of the state machine, None before the first report."""
        return self._report.state if self._report else None

    @property
    def shutting_down(self) -> bool:
        """True while the daemon ends."""
        return self._report is not None and self._report.shutting_down

    @property
    def message(self) -> Payload | None:
        """Payload to publish, None before the first report."""
        if self._report is None:
            return None
        standing = Standing(self._since, self._last_trip, self._clock, self._changed_at)
        return state_message(self._report, standing, self._profile)

    def show(self, report: StateReport) -> None:
        """Take a report of the runtime."""
        known, self._report = self._report, report
        if report == known:
            return
        self._note_change()
        if known is None or report.state is not known.state:
            self._since = self._changed_at
        if report.trip is not None and (known is None or report.trip != known.trip):
            self._last_trip = LastTrip(self._changed_at, report.trip, remedy(report.trip))

    def show_clock(self, clock: Synchronisation) -> None:
        """Store whether the wall clock is synchronised."""
        if clock is not self._clock:
            self._clock = clock
            self._note_change()

    async def change(self) -> None:
        """Wait until something is new since the last wait."""
        await self._changed.wait()
        self._changed.clear()

    def _note_change(self) -> None:
        self._changed_at = self._wall()
        self._changed.set()
