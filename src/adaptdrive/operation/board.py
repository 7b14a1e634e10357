"""Reports to publish: the present state, and queues of what was not published yet."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeVar

from adaptdrive.operation.clock import Synchronisation, WallClock
from adaptdrive.operation.messages import LastTrip, Payload, Profile, Standing, state_message
from adaptdrive.runtime.reports import Bounded, State, StateReport
from adaptdrive.runtime.trips import remedy

T = TypeVar("T")


class Mailbox(Bounded[T]):
    """A queue of which one item at a time is taken."""

    async def oldest(self) -> T:
        """Wait for an item; it stays in the queue."""
        await self._filled.wait()
        return self._items[0]

    async def take(self) -> T:
        """Wait for the oldest item and take it."""
        item = await self.oldest()
        self._strike_out()
        return item

    def _strike_out(self) -> None:
        self._items.popleft()
        if not self._items:
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
        self._profile = profile
        self._report: StateReport | None = None
        now = wall()
        self._standing = Standing(now, last_trip, Synchronisation.UNKNOWN, now)
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
        return state_message(self._report, self._standing, self._profile)

    def show(self, report: StateReport) -> None:
        """Take a report of the runtime."""
        known, self._report = self._report, report
        if report == known:
            return
        self._note_change()
        now = self._standing.time
        if known is None or report.state is not known.state:
            self._standing = replace(self._standing, since=now)
        if report.trip is not None and (known is None or report.trip != known.trip):
            trip = LastTrip(now, report.trip, remedy(report.trip))
            self._standing = replace(self._standing, last_trip=trip)

    def show_clock(self, clock: Synchronisation) -> None:
        """Store whether the wall clock is synchronised."""
        if clock is not self._standing.clock:
            self._standing = replace(self._standing, clock=clock)
            self._note_change()

    async def change(self) -> None:
        """Wait until something is new since the last wait."""
        await self._changed.wait()
        self._changed.clear()

    def _note_change(self) -> None:
        self._standing = replace(self._standing, time=self._wall())
        self._changed.set()


LIMIT = 10_000


class Outbox(Mailbox[bytes]):
    """A queue of payloads, each of which stays until the broker has it."""

    def __init__(
        self, recalled: Iterable[bytes], note_sent: Callable[[], None], limit: int = LIMIT
    ) -> None:
        """Begin with what an earlier run could not send.

        Args:
            recalled: Payloads, the oldest first.
            note_sent: Has the log know that the broker has the oldest one.
            limit: Most payloads that wait.
        """
        super().__init__(limit)
        self._note_sent = note_sent
        for body in recalled:
            self.put(body)

    def sent(self, body: bytes) -> None:
        """Strike out the oldest payload, which the broker has acknowledged, unless it went."""
        if self._items and self._items[0] is body:
            self._strike_out()
            self._note_sent()
