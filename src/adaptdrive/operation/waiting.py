"""Messages that wait to be read: a flood costs the oldest of them, and never more memory."""

from __future__ import annotations

import asyncio
from collections import deque

from aiomqtt import Message

_KEPT = "/disable"
"""How the topic of a command ends that is given up for no other."""


class NewestMessages(asyncio.Queue[Message]):
    """A queue that makes room for the newest message.

    What it overrides is private to asyncio, but documented there for this very purpose.

    Attributes:
        dropped: Messages that went to make room.
    """

    _queue: deque[Message]

    def __init__(self, maxsize: int = 0) -> None:
        super().__init__(maxsize)
        self.dropped = 0

    def put_nowait(self, item: Message) -> None:
        """Append a message; when the queue is full the oldest goes that does not stop a drive."""
        if self.full():
            self._drop_oldest()
        super().put_nowait(item)

    def _drop_oldest(self) -> None:
        index = next((i for i, one in enumerate(self._queue) if not _stops(one)), 0)
        del self._queue[index]
        self.dropped += 1


def _stops(message: Message) -> bool:
    return message.topic.value.endswith(_KEPT)
