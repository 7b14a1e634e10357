"""Memory of the last trip, so that its cause and remedy survive a restart of the daemon."""

from __future__ import annotations

from datetime import datetime

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.operation.journal import Journal
from adaptdrive.operation.messages import LastTrip
from adaptdrive.runtime.trips import remedy


class _Row(msgspec.Struct, frozen=True):
    """A trip on disk; its remedy is looked up again by the daemon that reads it."""

    time: datetime
    text: str


class TripMemory:
    """The last trip, across restarts.

    Attributes:
        last: The last trip, None before the first.
    """

    def __init__(self, journal: Journal) -> None:
        self.last: LastTrip | None = None
        self._journal = journal

    async def load(self) -> int:
        """Recall the last trip of an earlier run, unless this one has tripped.

        Returns:
            Rows that cannot be read.
        """
        rows = await self._journal.rows("SELECT body FROM trip")
        found = [_trip(body) for (body,) in rows]
        if self.last is None:
            self.last = next((trip for trip in found if trip is not None), None)
        return sum(trip is None for trip in found)

    def rewrite(self) -> None:
        """Write the last trip; the disk may have missed it."""
        if self.last is not None:
            self.note(self.last)

    def note(self, trip: LastTrip) -> None:
        """Remember a trip; returns at once, the disk follows."""
        self.last = trip
        body = msgspec.json.encode(_Row(trip.time, trip.text))
        self._journal.post("INSERT OR REPLACE INTO trip VALUES (1, ?)", (body,))


def _trip(body: object) -> LastTrip | None:
    """Return the trip in a row, None where it cannot be read."""
    if not isinstance(body, bytes | str):
        return None
    try:
        row = msgspec.json.decode(body, type=_Row)
    except NOT_JSON:
        return None
    return LastTrip(row.time, row.text, remedy(row.text))
