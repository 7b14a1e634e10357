"""What goes through the pipe from the control process to the recorder process.

Each message is a length (four bytes, little-endian) and that many bytes of MessagePack: one
`Header`, then `Batch` after `Batch`. Numbers of fast ticks travel as packed machine arrays, so
that a float arrives with the very bits it left with.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from operator import attrgetter
from typing import Any, BinaryIO, Literal

import msgspec

from adaptdrive.recording.session import Dropped, SessionInfo
from adaptdrive.runtime.reports import Event, LoadReport, TickReport

_LENGTH_BYTES = 4


@dataclass(frozen=True, slots=True)
class TickColumn:
    """One column of the fast ticks.

    Attributes:
        name: Its name on disk.
        code: `d` float64, `q` int64, `b` bool, `s` string.
        read: Takes its value from a report.
    """

    name: str
    code: Literal["d", "q", "b", "s"]
    read: Callable[[TickReport], Any]


TICK_COLUMNS = (
    TickColumn("sequence", "q", attrgetter("sequence")),
    TickColumn("tick", "q", attrgetter("measurement.tick")),
    TickColumn("tick_period_s", "d", attrgetter("measurement.tick_period_s")),
    TickColumn("boost_voltage_V", "d", attrgetter("measurement.boost_voltage_V")),
    TickColumn("line_voltage_V", "d", attrgetter("measurement.line_voltage_V")),
    TickColumn("load_power_W", "d", attrgetter("measurement.load_power_W")),
    TickColumn("output", "d", attrgetter("measurement.output")),
    TickColumn("fresh", "b", attrgetter("measurement.fresh")),
    TickColumn("stage", "s", attrgetter("order.stage")),
    TickColumn("reference", "d", attrgetter("order.reference")),
    TickColumn("mode", "s", attrgetter("order.mode")),
    TickColumn("pole", "d", attrgetter("order.pole")),
    TickColumn("applied_k", "q", attrgetter("applied_k")),
    TickColumn("current_scale_S", "d", attrgetter("command.current_scale_S")),
    TickColumn("command_boost_reference_V", "d", attrgetter("command.boost_reference_V")),
    TickColumn("bridge", "b", attrgetter("command.bridge")),
    TickColumn("lateness_us", "d", attrgetter("lateness_us")),
    TickColumn("turnaround_us", "d", attrgetter("turnaround_us")),
    TickColumn("tick_us", "d", attrgetter("tick_us")),
)


class TickTable:
    """Fast ticks turned into columns, a slice at a time."""

    def __init__(self) -> None:
        self.rows = 0
        self._columns: dict[str, Any] = {
            column.name: [] if column.code == "s" else array(column.code) for column in TICK_COLUMNS
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


class EstimateRow(msgspec.Struct, frozen=True):
    """One estimated parameter of a slow step."""

    name: str
    value: float
    std: float


class SlowRow(msgspec.Struct, frozen=True):
    """One slow step as it is recorded: the snapshot, and what was decided."""

    k: int
    tick: int
    period_s: float
    reference: float
    output: float
    output_filtered: tuple[float, ...]
    input_filtered: tuple[float, ...]
    applied_V: float
    followed: bool
    held_ticks: int
    boost_reference_V: float
    controller: str
    accepted: bool
    reason: str
    estimates: tuple[EstimateRow, ...]
    gains: tuple[float, ...]
    innovation: float
    excitation: float
    handover_step_V: float


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
    slow: list[SlowRow]
    events: list[EventRow]
    dropped: Dropped
    last: bool

    @property
    def empty(self) -> bool:
        """True when there is nothing to tell."""
        return not (self.tick_rows or self.slow or self.events or self.last)


def slow_row(report: LoadReport) -> SlowRow:
    """Flatten one slow step."""
    snapshot, decision = report.snapshot, report.decision
    return SlowRow(
        k=snapshot.k,
        tick=snapshot.tick,
        period_s=snapshot.period_s,
        reference=snapshot.order.reference,
        output=snapshot.output,
        output_filtered=snapshot.output_filtered,
        input_filtered=snapshot.input_filtered,
        applied_V=snapshot.applied_V,
        followed=snapshot.followed,
        held_ticks=snapshot.held_ticks,
        boost_reference_V=decision.boost_reference_V,
        controller=decision.controller.value,
        accepted=decision.accepted,
        reason=decision.reason,
        estimates=tuple(
            EstimateRow(name, estimate.value, estimate.std)
            for name, estimate in decision.estimates.items()
        ),
        gains=decision.gains,
        innovation=decision.innovation,
        excitation=decision.excitation,
        handover_step_V=decision.handover_step_V,
    )


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
