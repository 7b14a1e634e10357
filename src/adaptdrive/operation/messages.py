"""Payloads of the daemon: state, telemetry, events and replies.

A payload holds the fields of a report, as `runtime/reports.py` documents them. It is JSON in SI
units with RFC 3339 times in UTC. JSON knows neither NaN nor infinity: the encoder writes null.
"""

from __future__ import annotations

import dataclasses
from datetime import datetime
from typing import TYPE_CHECKING, Any

import msgspec

from adaptdrive.operation.clock import Synchronisation
from adaptdrive.runtime.reports import (
    SLOW_COLUMNS,
    DriveReport,
    Event,
    LoadReport,
    State,
    StateReport,
)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ONLINE = b"online"
OFFLINE = b"offline"

Payload = dict[str, Any]

_MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
"""Null before the first measurement."""


class Reply(msgspec.Struct, frozen=True):
    """Payload of `reply`.

    Attributes:
        id: Id of the command; a number only where a malformed command had one.
        verb: What was asked.
        accepted: Whether it was carried out.
        reason: Why not; empty when it was.
        state: State of the drive afterwards, None while it is not known yet.
    """

    id: str | int
    verb: str
    accepted: bool
    reason: str
    state: State | None


def encode(message: msgspec.Struct | Payload) -> bytes:
    """The JSON text of a message."""
    return msgspec.json.encode(message)


def state_message(report: StateReport, clock: Synchronisation, time: datetime) -> Payload:
    """Return the payload of `state` for a report that was true from `time` on."""
    return _fields(report) | {"clock": clock, "time": time}


def load_message(report: LoadReport, time: datetime) -> Payload:
    """Return the payload of `telemetry/load` for a report that arrived at `time`."""
    return {"time": time} | {column.name: column.read(report) for column in SLOW_COLUMNS}


def drive_message(report: DriveReport, time: datetime) -> Payload:
    """Return the payload of `telemetry/drive` for a report that arrived at `time`."""
    measured = {name: getattr(report.measurement, name, None) for name in _MEASURED}
    sensors = {one.name: _fields(one, "name") for one in report.sensors}
    whole = _fields(report, "measurement", "sensors", "time_s")
    return {"time": time} | measured | whole | {"sensors": sensors}


def event_message(event: Event, time: datetime) -> Payload:
    """Return the payload of `event` for something that was reported at `time`."""
    return {"time": time} | _fields(event)


def _fields(report: DataclassInstance, *left_out: str) -> Payload:
    names = (field.name for field in dataclasses.fields(report))
    return {name: getattr(report, name) for name in names if name not in left_out}
