"""Events that wait for the broker: bounded, in order, and kept on disk until it has them."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from adaptdrive.operation.clock import WallClock
from adaptdrive.operation.journal import Journal

LIMIT = 10_000
_MICRO = 1e6
_LATEST = 1 << 62
"""Sequence number that no clock gives; SQLite holds none above twice this one."""


class Outbox:
    """A queue of payloads that survives restarts; the oldest goes when it is full.

    Attributes:
        limit: Most payloads that wait.
        dropped: Payloads that went because the queue was full.
    """

    def __init__(self, journal: Journal, wall: WallClock, limit: int = LIMIT) -> None:
        self.dropped = 0
        self._journal = journal
        self.limit = limit
        self._waiting: OrderedDict[int, bytes] = OrderedDict()
        # Above all numbers of earlier runs, whose rows may be read later than the first event.
        self._last = int(wall().timestamp() * _MICRO)
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._waiting)

    async def load(self) -> int:
        """Queue what an earlier run could not send, before what this one has queued.

        Returns:
            Rows that cannot be read.
        """
        rows = await self._journal.rows("SELECT sequence, body FROM event ORDER BY sequence")
        readable = [(one, body) for one, body in rows if _is_event(one, body)]
        held = self._waiting
        self._waiting = OrderedDict()
        for sequence, body in (*readable, *held.items()):
            self._insert(sequence, body)
        return len(rows) - len(readable)

    def rewrite(self) -> None:
        """Write all that waits; the disk has missed some of it."""
        self._journal.post("DELETE FROM event")
        for sequence, body in self._waiting.items():
            self._post(sequence, body)

    def append(self, body: bytes) -> None:
        """Queue a payload; returns at once, the disk follows."""
        sequence = self._last + 1
        self._insert(sequence, body)
        self._post(sequence, body)

    async def oldest(self) -> tuple[int, bytes]:
        """Wait for a payload; it stays queued until `sent`.

        Returns:
            Its sequence number and the payload.
        """
        await self._filled.wait()
        return next(iter(self._waiting.items()))

    def sent(self, sequence: int) -> None:
        """Strike out a payload that the broker has acknowledged."""
        if self._waiting.pop(sequence, None) is not None:
            self._strike(sequence)

    def _post(self, sequence: int, body: bytes) -> None:
        self._journal.post("INSERT OR REPLACE INTO event VALUES (?, ?)", (sequence, body))

    def _insert(self, sequence: int, body: bytes) -> None:
        self._waiting[sequence] = body
        self._last = max(self._last, sequence)
        self._filled.set()
        if len(self._waiting) > self.limit:
            oldest, _ = self._waiting.popitem(last=False)
            self.dropped += 1
            self._strike(oldest)

    def _strike(self, sequence: int) -> None:
        self._journal.post("DELETE FROM event WHERE sequence = ?", (sequence,))
        if not self._waiting:
            self._filled.clear()


def _is_event(sequence: object, body: object) -> bool:
    """Return whether a row can be one of ours: a damaged table can hold anything."""
    return isinstance(sequence, int) and sequence < _LATEST and isinstance(body, bytes)
