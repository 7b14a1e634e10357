"""Payloads of the log's records: rows of ticks, slow steps and sensors, events and commands.

Numbers of fast ticks are packed machine arrays, so that a float is read with the very bits that it
was written with.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

import msgspec

from adaptdrive.recording.session import SessionInfo
from adaptdrive.runtime.reports import (
    MONOTONIC,
    SLOW_COLUMNS,
    TICK_COLUMNS,
    CommandReport,
    DriveReport,
    Event,
    LoadReport,
    SensorSample,
    Severity,
    TickReport,
)

_CODES = {float: "d", int: "q", bool: "b"}


class Ticks(msgspec.Struct, frozen=True):
    """Fast ticks.

    Attributes:
        rows: Their number.
        columns: Bytes of machine numbers, or texts, by name of the column.
    """

    rows: int
    columns: dict[str, bytes | list[str]]


def packed_ticks(reports: Sequence[TickReport]) -> Ticks:
    """Return fast ticks as they are recorded; costs a few microseconds each."""
    columns: dict[str, bytes | list[str]] = {}
    for column in TICK_COLUMNS:
        code, values = _CODES.get(column.kind), map(column.read, reports)
        columns[column.name] = array(code, values).tobytes() if code else list(values)
    return Ticks(len(reports), columns)


class EventRow(msgspec.Struct, frozen=True):
    """One event as it is recorded.

    Attributes:
        time: When it was heard of, UTC.
        tick: Fast tick at which it happened.
        kind: Machine-readable name.
        severity: How much it matters.
        detail: One sentence.
        monotonic_s: When it was heard of.
        number: Running number in the session, from 1.
    """

    time: datetime
    tick: int
    kind: str
    severity: str
    detail: str
    monotonic_s: float
    number: int

    @property
    def event(self) -> Event:
        """The event as it was reported."""
        return Event(self.kind, Severity(self.severity), self.detail, self.tick)


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


class Header(msgspec.Struct, frozen=True):
    """A session, as each file of the log that belongs to it describes it.

    Attributes:
        info: Facts about the session.
        config_text: The configuration in force, as TOML.
        sessions: Folder of all sessions, from the state directory on; empty where none is
            recorded.
        segment_s: Length of a segment of the session.
        keep: How long sessions are kept.
    """

    info: SessionInfo
    config_text: str
    sessions: str = ""
    segment_s: float = 3600.0
    keep: Keep = Keep()


def slow_row(report: LoadReport) -> dict[str, Any]:
    """Return one slow step as it is recorded: its columns by name."""
    return {column.name: _plain(column.read(report)) for column in SLOW_COLUMNS}


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a column holds
    """Return a value as Arrow takes it: estimates by name become a list."""
    if not isinstance(value, dict):
        return value
    return [{"name": name, "value": one.value, "std": one.std} for name, one in value.items()]


def sensor_row(report: DriveReport | SensorSample) -> dict[str, float]:
    """Return the values of the sensor buses and their ages, by name of their column."""
    values = {MONOTONIC: report.time_s}
    if isinstance(report, SensorSample):
        values.update(report.values)
        values.update((f"{name}.age_s", age_s) for name, age_s in report.age_s.items())
        return values
    for bus in report.sensors:
        for name, value in bus.values.items():
            values[f"{bus.name}.{name}"] = value
            values[f"{bus.name}.{name}.age_s"] = bus.age_s[name]
    return values


def note_row(
    report: Event | CommandReport, time: datetime, monotonic_s: float, number: int
) -> EventRow | CommandRow:
    """Return the row of one event or operator command with the time of its report."""
    kind = EventRow if isinstance(report, Event) else CommandRow
    return kind(time=time, monotonic_s=monotonic_s, number=number, **asdict(report))
