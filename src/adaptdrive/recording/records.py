"""Records of the log: their payloads, and the frames with number, time, kind and checksum.

Numbers of fast ticks are packed machine arrays, so that a float is read with the very bits that it
was written with.

A frame is a mark of four bytes, the length of the rest and its CRC-32 (little-endian, four bytes
each), and the rest: number (eight bytes), monotonic and wall time (eight bytes each, in seconds),
kind (one byte) and payload. A reader that finds a frame damaged looks for the next mark whose frame
is sound, and reports what it has passed over.
"""

import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from enum import IntEnum
from typing import Any

import msgspec

from adaptdrive.control.loads.load import Products
from adaptdrive.recording.session import SessionInfo
from adaptdrive.runtime import reports
from adaptdrive.safety.trips import kind_of

# Payloads of the log's records: rows of ticks, slow steps and sensors, events and commands.

_CODES = {float: "d", int: "q", bool: "b"}


class Ticks(msgspec.Struct, frozen=True):
    """Fast ticks.

    Attributes:
        rows: Their number.
        columns: Bytes of machine numbers, or texts, by name of the column.
    """

    rows: int
    columns: dict[str, bytes | list[str]]


def packed_ticks(ticks: Sequence[reports.TickReport]) -> Ticks:
    """Return fast ticks as they are recorded; costs a few microseconds each."""
    columns: dict[str, bytes | list[str]] = {}
    for column in reports.TICK_COLUMNS:
        code, values = _CODES.get(column.kind), map(column.read, ticks)
        columns[column.name] = array(code, values).tobytes() if code else list(values)
    return Ticks(len(ticks), columns)


class EventRow(msgspec.Struct, frozen=True):
    """One event as it is recorded.

    Attributes:
        time: When it was reported, UTC.
        tick: Fast tick at which it happened.
        kind: Machine-readable name.
        severity: How much it matters.
        detail: One sentence.
        monotonic_s: When it was reported, monotonic.
        number: Running number in the session, from 1.
        trip_kind: Kind of the trip, None where it is none.
    """

    time: datetime
    tick: int
    kind: str
    severity: str
    detail: str
    monotonic_s: float
    number: int
    trip_kind: str | None = None

    @property
    def event(self) -> reports.Event:
        """The event as it was reported."""
        severity, kind = reports.Severity(self.severity), kind_of(self.trip_kind)
        return reports.Event(self.kind, severity, self.detail, self.tick, kind)


class CommandRow(msgspec.Struct, frozen=True):
    """One operator command as it is recorded.

    Attributes:
        time: When it was answered, UTC.
        monotonic_s: When it was answered.
        id: Id that its sender gave it.
        verb: What was asked for.
        value: The value asked for, as JSON.
        user: Name that its sender gives itself; empty without one.
        accepted: Whether it was carried out.
        reason: Why not.
        number: Running number in the session, from 1.
    """

    time: datetime
    monotonic_s: float
    id: str
    verb: str
    value: str
    user: str
    accepted: bool
    reason: str
    number: int


class Keep(msgspec.Struct, frozen=True):
    """Retention limits of sessions.

    Attributes:
        days: Oldest session kept, None for ever.
        bytes: Size of all sessions, None for no limit.
    """

    days: float | None = None
    bytes: int | None = None


class HealthSettings(msgspec.Struct, frozen=True):
    """What gives the estimates of a drive their meaning for the health of its load.

    Attributes:
        products: What the parameters of the load say of it.
        loss: Name of what acts against its input; empty where its estimates are no physical
            parameters.
        share: 1 - ρ, what a sample brings of what an estimate knows.
        least_excitation: rᵀPr above which a sample teaches.
        bounds: Lowest and highest value of quantities, infinite where there is no limit.
    """

    products: Products = {}
    loss: str = ""
    share: float = 1.0
    least_excitation: float = 0.0
    bounds: dict[str, tuple[float, float]] = {}


@dataclass(frozen=True, slots=True)
class Pace:
    """Intervals and time-outs of the recorder's writes.

    Attributes:
        flush_s: Longest time that ticks stay in the control process.
        backlog_bytes: Bytes of rows that may wait to be written; then the oldest are dropped.
            About 200 s at 120 Hz.
        close_s: Longest time that the end of the recording takes, in two parts: the log, and the
            archiver.
        trip_s: Time after a trip that belongs to its record.
        keep_s: Longest time that an event waits for its record before it is published.
        start_thread: What a thread that writes does first.
    """

    flush_s: float = 0.2
    backlog_bytes: int = 4 << 20
    close_s: float = 8.0
    trip_s: float = 10.0
    keep_s: float = 0.2
    start_thread: Callable[[], None] = lambda: None


class Header(msgspec.Struct, frozen=True):
    """A session, as each file of the log that belongs to it describes it.

    Attributes:
        info: Facts about the session.
        config_text: The configuration in force, as TOML.
        sessions: Folder of all sessions, from the state directory on; empty where none is
            recorded.
        segment_s: Length of a segment of the session.
        keep: How long sessions are kept.
        health: What gives its estimates their meaning for the health of the load.
    """

    info: SessionInfo
    config_text: str
    sessions: str = ""
    segment_s: float = 3600.0
    keep: Keep = Keep()
    health: HealthSettings = HealthSettings()


def slow_row(report: reports.LoadReport) -> dict[str, Any]:
    """Return one slow step as it is recorded: its columns by name."""
    return {column.name: _plain(column.read(report)) for column in reports.SLOW_COLUMNS}


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a column holds
    """Return a value as Arrow takes it: estimates by name become a list."""
    if not isinstance(value, dict):
        return value
    return [{"name": name, "value": one.value, "std": one.std} for name, one in value.items()]


def sensor_row(report: reports.DriveReport | reports.SensorSample) -> dict[str, float]:
    """Return the values of the sensor buses and their ages, by name of their column."""
    values = {reports.MONOTONIC: report.time_s}
    if isinstance(report, reports.SensorSample):
        values.update(report.values)
        values.update((f"{name}.age_s", age_s) for name, age_s in report.age_s.items())
        return values
    for bus in report.sensors:
        for name, value in bus.values.items():
            values[f"{bus.name}.{name}"] = value
            values[f"{bus.name}.{name}.age_s"] = bus.age_s[name]
    return values


def note_row(
    report: reports.Event | reports.CommandReport, time: datetime, monotonic_s: float, number: int
) -> EventRow | CommandRow:
    """Return the row of one event or operator command with the time of its report."""
    kind = EventRow if isinstance(report, reports.Event) else CommandRow
    return kind(time=time, monotonic_s=monotonic_s, number=number, **asdict(report))


# Frames of the log: records with their number, times, kind and checksum, in a file.

_MARK = b"aDl\x01"
_OUTER = struct.Struct("<4sII")
_INNER = struct.Struct("<QddB")
LARGEST_BYTES = 1 << 26
"""Longest rest of a frame: several times that of any record."""


class Kind(IntEnum):
    """Kind of a record."""

    BEGIN = 1
    """First of a segment: the session that it belongs to, and what earlier segments left."""
    TICKS = 2
    SLOW = 3
    SENSORS = 4
    EVENT = 5
    COMMAND = 6
    REPLY = 7
    """Reply to a command, for a repetition of it."""
    SENT = 8
    """The broker has the oldest event that it did not have."""
    LEARNT = 9
    """Estimates for the next run."""
    DROPPED = 10
    """Rows of tables that could not be kept so far."""
    END = 11
    """Orderly end of a session."""


ROW_KINDS = frozenset({Kind.TICKS, Kind.SLOW, Kind.SENSORS})
"""Kinds of which payloads are compressed, and of which the oldest may be dropped."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record.

    Attributes:
        number: Running number in the log, 0 before it is written.
        monotonic_s: When it was handed over.
        wall_s: When, by the wall clock, in seconds since 1970.
        kind: Its kind.
        payload: Its contents.
        rows: Rows of tables in it, known before it is written.
    """

    number: int
    monotonic_s: float
    wall_s: float
    kind: Kind
    payload: bytes
    rows: int = 0


def framed(record: Record) -> bytes:
    """Return a record as it is in a segment."""
    inner = _INNER.pack(record.number, record.monotonic_s, record.wall_s, record.kind)
    checksum = zlib.crc32(record.payload, zlib.crc32(inner))
    return _OUTER.pack(_MARK, len(inner) + len(record.payload), checksum) + inner + record.payload


def read_frames(content: bytes) -> Iterator[Record | tuple[int, int]]:
    """Yield the records of a segment, and each part without one: its first byte and its end.

    Args:
        content: The segment, which may break off anywhere.
    """
    place = 0
    while place < len(content):
        record, end = _frame(content, place)
        if record is None:
            end = _next_sound(content, place + 1)
            yield place, end
        else:
            yield record
        place = end


def _frame(content: bytes, place: int) -> tuple[Record | None, int]:
    """Return the frame at a place and its end; None where there is no sound one."""
    begin = place + _OUTER.size
    if begin + _INNER.size > len(content):
        return None, place
    mark, length, checksum = _OUTER.unpack_from(content, place)
    end = begin + length
    if mark != _MARK or not _INNER.size <= length <= LARGEST_BYTES or end > len(content):
        return None, place
    if zlib.crc32(memoryview(content)[begin:end]) != checksum:
        return None, place
    number, monotonic_s, wall_s, kind = _INNER.unpack_from(content, begin)
    try:
        kind = Kind(kind)
    except ValueError:  # of another version
        return None, place
    return Record(number, monotonic_s, wall_s, kind, content[begin + _INNER.size : end]), end


def _next_sound(content: bytes, place: int) -> int:
    """Return where the next sound frame begins, the end of the content where there is none."""
    while (place := content.find(_MARK, place)) >= 0:
        if _frame(content, place)[0] is not None:
            return place
        place += 1
    return len(content)
