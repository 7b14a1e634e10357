"""Records of the operators' side in the log, and those that an earlier run has left there."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from adaptdrive.operation.memory import Recalled
from adaptdrive.runtime.reports import Event


async def _wait_for_nothing(_patience_s: float) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Ledger:
    """The log, as the operators' side sees it; by default one that keeps nothing.

    Attributes:
        replies: Replies of earlier runs, the oldest first.
        events: Time and contents of the events that the broker does not have, the oldest first.
        trip: Time and text of the last trip, None before the first.
        note_reply: Has a reply kept by its id.
        note_sent: Has it kept that the broker has the oldest event.
        kept: Waits until the disk keeps what was noted and published, for a longest time in s.
    """

    replies: Sequence[Recalled] = ()
    events: Sequence[tuple[datetime, Event]] = ()
    trip: tuple[datetime, str] | None = None
    note_reply: Callable[[str, bytes], None] = lambda _identity, _body: None
    note_sent: Callable[[], None] = lambda: None
    kept: Callable[[float], Awaitable[None]] = _wait_for_nothing
