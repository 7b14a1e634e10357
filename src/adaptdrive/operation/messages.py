"""Payloads of the daemon: state, telemetry, events and replies.

A payload holds the fields of a report, as `runtime/reports.py` documents them. It is JSON in SI
units with RFC 3339 times in UTC. JSON has neither NaN nor infinity: the encoder writes null.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

import msgspec

from adaptdrive.operation.clock import Synchronisation
from adaptdrive.operation.profile import Output, Profile
from adaptdrive.runtime.reports import (
    SLOW_COLUMNS,
    DriveReport,
    Event,
    LoadReport,
    Severity,
    State,
    StateReport,
)
from adaptdrive.runtime.trips import remedy

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ONLINE = b"online"
OFFLINE = b"offline"

Payload = dict[str, Any]

MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
"""Null before the first measurement."""


class Reply(msgspec.Struct, frozen=True):
    """Payload of `reply`.

    Attributes:
        id: Id of the command; a number only where a malformed command had one, None where none
            can be read.
        verb: What was asked.
        accepted: Whether it was carried out.
        reason: Why not; empty when it was.
        state: State of the drive afterwards, None while it is not known yet.
    """

    id: str | int | None
    verb: str
    accepted: bool
    reason: str
    state: State | None


@dataclass(frozen=True, slots=True)
class LastTrip:
    """The last trip, of this run of the daemon or of an earlier one.

    Attributes:
        time: Time of the trip.
        text: Text of the trip.
        remedy: Steps that remove its cause, before `reset`; empty for an unknown cause.
    """

    time: datetime
    text: str
    remedy: str


@dataclass(frozen=True, slots=True)
class Standing:
    """The times of `state`, and the clock that they were read from.

    Attributes:
        since: Time at which the drive entered its state.
        last_trip: The last trip, None before the first.
        clock: Synchronisation of the daemon's clock.
        time: Time of the last change of anything in `state`.
    """

    since: datetime
    last_trip: LastTrip | None
    clock: Synchronisation
    time: datetime


def encode(message: msgspec.Struct | Payload) -> bytes:
    """The JSON text of a message."""
    return msgspec.json.encode(message)


def state_message(report: StateReport, standing: Standing, profile: Profile) -> Payload:
    """Return the payload of `state`."""
    return _fields(report) | _fields(standing) | _fields(profile)


def load_message(report: LoadReport, time: datetime, output: Output) -> Payload:
    """Return the payload of `telemetry/load` for a report that arrived at `time`."""
    columns = {column.name: column.read(report) for column in SLOW_COLUMNS}
    return {"time": time} | columns | _named(output)


def histogram_message(report: DriveReport, time: datetime) -> Payload:
    """Return the payload of `telemetry/histograms` for a report that arrived at `time`."""
    return {"time": time} | dict(report.histograms)


def drive_message(report: DriveReport, time: datetime, output: Output) -> Payload:
    """Return the payload of `telemetry/drive` for a report that arrived at `time`."""
    measured = {name: getattr(report.measurement, name, None) for name in MEASURED}
    sensors = {one.name: _fields(one, "name") for one in report.sensors}
    whole = _fields(report, "measurement", "sensors", "histograms", "time_s")
    return {"time": time} | measured | whole | {"sensors": sensors} | _named(output)


def event_message(event: Event, time: datetime) -> Payload:
    """Return the payload of `event` for something that was reported at `time`."""
    known = remedy(event.detail) if event.severity is Severity.ALARM else ""
    return {"time": time} | _fields(event) | {"remedy": known}


def _named(output: Output) -> Payload:
    return {"output_name": output.name, "output_unit": output.unit}


def _fields(report: DataclassInstance, *left_out: str) -> Payload:
    names = (field.name for field in dataclasses.fields(report))
    return {name: getattr(report, name) for name in names if name not in left_out}
