"""What goes through the pipe from the control process to the recorder process.

Each message is a length (four bytes, little-endian) and that many bytes of MessagePack: one
`Header`, then `Batch` after `Batch`. Numbers of fast ticks travel as packed machine arrays, so
that a float arrives with the very bits it left with.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any, BinaryIO

import msgspec

from adaptdrive.recording.session import Dropped, SessionInfo
from adaptdrive.runtime.reports import SLOW_COLUMNS, TICK_COLUMNS, Event, LoadReport, TickReport

_LENGTH_BYTES = 4


_CODES = {float: "d", int: "q", bool: "b"}


class TickTable:
    """Fast ticks turned into columns, a slice at a time."""

    def __init__(self) -> None:
        self.rows = 0
        self._columns: dict[str, Any] = {
            column.name: array(_CODES[column.kind]) if column.kind in _CODES else []
            for column in TICK_COLUMNS
        }

    def extend(self, reports: Sequence[TickReport]) -> None:
        """Append reports; costs a few microseconds each."""
        for column in TICK_COLUMNS:
            self._columns[column.name].extend(map(column.read, reports))
        self.rows += len(reports)

    def packed(self) -> dict[str, bytes | list[str]]:
        """The columns by name: bytes of numbers, or strings."""
        return {
            name: values.tobytes() if isinstance(values, array) else values
            for name, values in self._columns.items()
        }


class EventRow(msgspec.Struct, frozen=True):
    """One event as it is recorded; `time` is UTC."""

    time: datetime
    tick: int
    kind: str
    severity: str
    detail: str


class Header(msgspec.Struct, frozen=True):
    """The first message of a session."""

    info: SessionInfo
    config_text: str


class Batch(msgspec.Struct, frozen=True):
    """What was gathered since the last batch.

    Attributes:
        tick_rows: Rows in `ticks`.
        ticks: Columns of fast ticks.
        slow: Slow steps.
        events: Events.
        dropped: Everything lost since the session began.
        last: The control process says goodbye.
    """

    tick_rows: int
    ticks: dict[str, bytes | list[str]]
    slow: list[dict[str, Any]]
    events: list[EventRow]
    dropped: Dropped
    last: bool

    @property
    def empty(self) -> bool:
        """True when there is nothing to tell."""
        return not (self.tick_rows or self.slow or self.events or self.last)


def slow_row(report: LoadReport) -> dict[str, Any]:
    """Return one slow step as it is recorded: its columns by name."""
    return {column.name: _plain(column.read(report)) for column in SLOW_COLUMNS}


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a column holds
    """Return a value as Arrow takes it: estimates by name become a list."""
    if not isinstance(value, dict):
        return value
    return [{"name": name, "value": one.value, "std": one.std} for name, one in value.items()]


def event_row(event: Event, time: datetime) -> EventRow:
    """Stamp one event with the time at which it was heard of."""
    return EventRow(time, event.tick, event.kind, event.severity.value, event.detail)


def framed(message: Header | Batch) -> bytes:
    """A message as it goes through the pipe."""
    body = msgspec.msgpack.encode(message)
    return len(body).to_bytes(_LENGTH_BYTES, "little") + body


def read_frames(stream: BinaryIO) -> Iterator[bytes]:
    """The bodies of the messages in a stream; one that breaks off at its end is left out."""
    while len(prefix := stream.read(_LENGTH_BYTES)) == _LENGTH_BYTES:
        length = int.from_bytes(prefix, "little")
        body = stream.read(length)
        if len(body) < length:
            return
        yield body
