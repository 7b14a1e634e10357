"""Events that wait for the broker: bounded and in order."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from adaptdrive.operation.board import Mailbox

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
