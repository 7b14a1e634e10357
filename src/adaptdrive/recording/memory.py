"""State that the log carries from segment to segment: a fold over its records.

Replies are remembered for commands that come again, events until the broker has them, and of trips
and estimates the last one. The first record of a segment has all of it, so that a segment can be
removed once its rows are in the folder of their session.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from datetime import datetime
from typing import Any

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.recording.frames import Kind, Record
from adaptdrive.recording.records import EventRow, Header

REPLIES = 1000
EVENTS = 10_000
TRIP = "trip"
"""Kind of the event of a trip."""


class Left(msgspec.Struct, frozen=True, kw_only=True):
    """State that survives segments and runs.

    Attributes:
        replies: Id, age in seconds and contents of each reply, the oldest first.
        unsent: Events that the broker does not have.
        trip: Event of the last trip.
        learnt: Estimates for the next run; empty for none.
    """

    replies: tuple[tuple[str, float, bytes], ...] = ()
    unsent: tuple[EventRow, ...] = ()
    trip: EventRow | None = None
    learnt: bytes = b""


class Begin(Left, frozen=True):
    """First record of a segment: what is left of those before it.

    Attributes:
        header: The session that it belongs to.
        part: Segment of the session that its rows are in, from 1.
    """

    header: Header
    part: int


class Recalled(Left, frozen=True, kw_only=True):
    """State that an earlier run has left.

    Attributes:
        number: Number of its last record.
        file: Number of its last file.
        flaws: What of it cannot be read, in words.
    """

    number: int = 0
    file: int = 0
    flaws: tuple[str, ...] = ()


class LogMemory:
    """The fold."""

    def __init__(self, left: Left, now_s: float) -> None:
        """Begin with what an earlier run or segment has left.

        Args:
            left: That.
            now_s: Present time, monotonic.
        """
        self._last: Record | None = None
        self._begin(left, now_s)

    def _begin(self, left: Left, now_s: float) -> None:
        self._replies = OrderedDict(
            (identity, (now_s - age_s, body)) for identity, age_s, body in left.replies
        )
        self._unsent = deque(left.unsent, maxlen=EVENTS)
        self._trip = left.trip
        self._learnt = left.learnt

    def take(self, record: Record) -> None:
        """Take a record; one that cannot be decoded has no effect.

        Args:
            record: The next one of the log.
        """
        try:
            self._take(record)
        except NOT_JSON:
            return
        self._last = record

    def _take(self, record: Record) -> None:
        match record.kind:
            case Kind.BEGIN:
                self._begin(msgspec.msgpack.decode(record.payload, type=Begin), record.monotonic_s)
            case Kind.REPLY:
                identity, body = msgspec.msgpack.decode(record.payload, type=tuple[str, bytes])
                self._replies.pop(identity, None)
                self._replies[identity] = record.monotonic_s, body
                if len(self._replies) > REPLIES:
                    self._replies.popitem(last=False)
            case Kind.EVENT:
                event = msgspec.msgpack.decode(record.payload, type=EventRow)
                self._unsent.append(event)
                if event.kind == TRIP:
                    self._trip = event
            case Kind.SENT:
                if self._unsent:
                    self._unsent.popleft()
            case Kind.LEARNT:
                self._learnt = record.payload
            case _:
                pass

    def begin(self, header: Header, part: int, now_s: float) -> Begin:
        """Return the first record of a segment.

        Args:
            header: The session.
            part: Segment of the session.
            now_s: Present time, monotonic.
        """
        return Begin(header, part, **self._left(now_s))

    def recalled(self, now: datetime, file: int, flaws: tuple[str, ...]) -> Recalled:
        """Return what the next run begins with; ages follow the wall clock.

        Args:
            now: Present time, UTC.
            file: Number of the last file.
            flaws: What could not be read.
        """
        if self._last is None:
            return Recalled(file=file, flaws=flaws)
        since_s = max(0.0, now.timestamp() - self._last.wall_s)
        left = self._left(self._last.monotonic_s + since_s)
        return Recalled(number=self._last.number, file=file, flaws=flaws, **left)

    def _left(self, now_s: float) -> dict[str, Any]:
        replies = (
            (identity, max(0.0, now_s - born_s), body)
            for identity, (born_s, body) in self._replies.items()
        )
        return {
            "replies": tuple(replies),
            "unsent": tuple(self._unsent),
            "trip": self._trip,
            "learnt": self._learnt,
        }
