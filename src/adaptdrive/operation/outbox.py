"""Events that wait for the broker: bounded, in order, and kept on disk until it has them."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from adaptdrive.operation.journal import Journal

LIMIT = 10_000


class Outbox:
    """A queue of payloads that survives restarts; the oldest goes when it is full.

    Attributes:
        dropped: Payloads that went because the queue was full.
    """

    def __init__(self, journal: Journal, limit: int = LIMIT) -> None:
        self.dropped = 0
        self._journal = journal
        self._limit = limit
        self._waiting: OrderedDict[int, bytes] = OrderedDict()
        self._last = 0
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._waiting)

    async def load(self) -> None:
        """Queue again what an earlier run could not send."""
        for sequence, body in await self._journal.rows(
            "SELECT sequence, body FROM event ORDER BY sequence"
        ):
            self._insert(sequence, bytes(body))

    def append(self, body: bytes) -> None:
        """Queue a payload; returns at once, the disk follows."""
        sequence = self._last + 1
        self._insert(sequence, body)
        self._journal.post("INSERT INTO event VALUES (?, ?)", (sequence, body))

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

    def _insert(self, sequence: int, body: bytes) -> None:
        self._waiting[sequence] = body
        self._last = sequence
        self._filled.set()
        if len(self._waiting) > self._limit:
            oldest, _ = self._waiting.popitem(last=False)
            self.dropped += 1
            self._strike(oldest)

    def _strike(self, sequence: int) -> None:
        self._journal.post("DELETE FROM event WHERE sequence = ?", (sequence,))
        if not self._waiting:
            self._filled.clear()
