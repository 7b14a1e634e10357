"""Archive that survives a restart of the daemon: replies, trips, and events not yet published."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from adaptdrive.operation.clock import Monotonic, WallClock
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.memory import ReplyMemory
from adaptdrive.operation.outbox import Outbox
from adaptdrive.operation.trip_memory import TripMemory
from adaptdrive.runtime.reports import Severity

Report = Callable[[str, Severity, str], None]
"""Takes kind, severity and text of an event."""

JOURNAL_RETRY_S = 10.0
FAREWELL_S = 5.0
"""For a disk that hangs at the end: less than a service manager waits before it kills."""


class Archive:
    """Keeps replies, trips and events in a journal, with a disk that works or without.

    Attributes:
        replies: Replies that were given.
        trips: Trips of this drive.
        outbox: Events that wait for the broker.
    """

    def __init__(self, journal: Journal, wall: WallClock, monotonic: Monotonic) -> None:
        """Open nothing yet.

        Args:
            journal: The file.
            wall: Wall clock in UTC.
            monotonic: Clock for intervals, in seconds.
        """
        self._journal = journal
        self._reported = ""
        self.replies = ReplyMemory(journal, wall, monotonic)
        self.trips = TripMemory(journal)
        self.outbox = Outbox(journal, wall)

    async def run(self, report: Report, recalled: Callable[[], None]) -> None:
        """Open the journal, and again when it has failed, until cancelled; nothing waits for it.

        Args:
            report: Takes the journal's problems.
            recalled: Called once, when what an earlier run left has been read.
        """
        loaded = False
        while True:
            self._report_new_problem(report)  # of a file that took some of what it was asked to
            if await self._journal.open():
                if not loaded:
                    unread = await self._load()
                    self._complain(report, self._journal.put_aside or unread)
                    recalled()
                loaded = True
                self._rewrite()
            self.replies.follow_clock()
            self.replies.begin()
            await self.replies.written()  # a file may be opened that takes nothing
            if self._journal.problem:
                self._report_new_problem(report)
            await asyncio.sleep(JOURNAL_RETRY_S)

    async def close(self) -> None:
        """Close the journal, in bounded time."""
        self.replies.follow_clock()
        await self._journal.close(FAREWELL_S)

    async def _load(self) -> str:
        """Recall what an earlier run left; return what of it cannot be read, empty for nothing."""
        replies, events = await self.replies.load(), await self.outbox.load()
        trips = await self.trips.load()
        if not (replies or events or trips):
            return ""
        return f"{replies} replies, {events} events and {trips} trips cannot be read"

    def _rewrite(self) -> None:
        """Write what this run holds."""
        self.replies.rewrite()
        self.outbox.rewrite()
        self.trips.rewrite()

    def _report_new_problem(self, report: Report) -> None:
        """Report the journal's problem once, until it is another one or gone for a while."""
        if self._journal.problem != self._reported:
            self._complain(report, self._journal.problem)
        self._reported = self._journal.problem

    def _complain(self, report: Report, problem: str) -> None:
        if problem:
            report(
                "journal",
                Severity.WARNING,
                f"{self._journal.path}: {problem}; after a restart commands with ids used before "
                "may be carried out again, and unsent events are lost",
            )
