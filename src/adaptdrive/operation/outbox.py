"""Events that wait for the broker: bounded and in order."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Iterable
from itertools import count

LIMIT = 10_000


class Outbox:
    """A queue of payloads; the oldest goes when it is full.

    Attributes:
        limit: Most payloads that wait.
        dropped: Payloads that went because the queue was full.
    """

    def __init__(
        self, recalled: Iterable[bytes], note_sent: Callable[[], None], limit: int = LIMIT
    ) -> None:
        """Begin with what an earlier run could not send.

        Args:
            recalled: Payloads, the oldest first.
            note_sent: Has the log know that the broker has the oldest one.
            limit: Most payloads that wait.
        """
        self.dropped = 0
        self.limit = limit
        self._note_sent = note_sent
        self._numbers = count()
        self._waiting: OrderedDict[int, bytes] = OrderedDict()
        self._filled = asyncio.Event()
        for body in recalled:
            self.append(body)

    def __len__(self) -> int:
        return len(self._waiting)

    def append(self, body: bytes) -> None:
        """Queue a payload; returns at once."""
        self._waiting[next(self._numbers)] = body
        self._filled.set()
        if len(self._waiting) > self.limit:
            self._waiting.popitem(last=False)
            self.dropped += 1

    async def oldest(self) -> tuple[int, bytes]:
        """Wait for a payload; it stays queued until `sent`.

        Returns:
            Its number and the payload.
        """
        await self._filled.wait()
        return next(iter(self._waiting.items()))

    def sent(self, number: int) -> None:
        """Strike out a payload that the broker has acknowledged."""
        if self._waiting.pop(number, None) is not None:
            self._note_sent()
        if not self._waiting:
            self._filled.clear()
