"""State that the log carries from segment to segment: a fold over its records.

Replies are remembered for commands that come again, events until the broker has them, and of trips
and estimates the last one. The first record of a segment has all of it, so that a segment can be
removed once its rows are in the folder of their session.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict, deque
from datetime import datetime

import msgspec

from adaptdrive.errors import NOT_JSON
from adaptdrive.recording.frames import Kind, Record
from adaptdrive.recording.records import EventRow, Header

REPLIES = 1000
EVENTS = 10_000
TRIP = "trip"
"""Kind of the event of a trip."""


class Recalled(msgspec.Struct, frozen=True, omit_defaults=True):
    """State that earlier segments and runs have left.

    Attributes:
        replies: Id, age in seconds and contents of each reply, the oldest first.
        unsent: Events that the broker does not have.
        trip: Event of the last trip.
        learnt: Estimates for the next run; empty for none.
        number: Number of the last record.
        file: Number of the last file.
        flaws: What of it cannot be read, in words.
    """

    replies: tuple[tuple[str, float, bytes], ...] = ()
    unsent: tuple[EventRow, ...] = ()
    trip: EventRow | None = None
    learnt: bytes = b""
    number: int = 0
    file: int = 0
    flaws: tuple[str, ...] = ()


class Begin(msgspec.Struct, frozen=True):
    """First record of a segment.

    Attributes:
        header: The session that it belongs to.
        part: Segment of the session that its rows are in, from 1.
        left: What segments before it have left.
    """

    header: Header
    part: int
    left: Recalled = Recalled()


class LogMemory:
    """The fold."""

    def __init__(self, recalled: Recalled, now_s: float) -> None:
        """Begin with what an earlier run has left.

        Args:
            recalled: That.
            now_s: Present time, monotonic.
        """
        self._last = Record(recalled.number, now_s, 0.0, Kind.BEGIN, b"")
        self._begin(recalled, now_s)

    @property
    def number(self) -> int:
        """Number of the last record."""
        return self._last.number

    def _begin(self, left: Recalled, now_s: float) -> None:
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
        self._last = record
        with contextlib.suppress(*NOT_JSON):
            match record.kind:
                case Kind.BEGIN:
                    begin = msgspec.msgpack.decode(record.payload, type=Begin)
                    self._begin(begin.left, record.monotonic_s)
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

    def left(self, now_s: float) -> Recalled:
        """Return what the next segment begins with.

        Args:
            now_s: Present time, monotonic.
        """
        replies = tuple(
            (identity, max(0.0, now_s - born_s), body)
            for identity, (born_s, body) in self._replies.items()
        )
        return Recalled(replies, tuple(self._unsent), self._trip, self._learnt, self.number)

    def recalled(self, now: datetime, file: int, flaws: tuple[str, ...]) -> Recalled:
        """Return what the next run begins with; ages follow the wall clock.

        Args:
            now: Present time, UTC.
            file: Number of the last file.
            flaws: What could not be read.
        """
        since_s = max(0.0, now.timestamp() - self._last.wall_s)
        left = self.left(self._last.monotonic_s + since_s)
        return msgspec.structs.replace(left, file=file, flaws=flaws)
