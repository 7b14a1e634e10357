"""What the daemon says: the payloads of state, telemetry, events and replies.

Payloads are JSON in SI units with RFC 3339 times in UTC. JSON knows no NaN and no infinity:
the encoder writes both as null.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import msgspec

from adaptdrive.control.signals import Command, Mode
from adaptdrive.control.waveform import Waveform
from adaptdrive.operation.clock import Synchronisation
from adaptdrive.runtime.reports import (
    SLOW_COLUMNS,
    DriveReport,
    Event,
    LoadReport,
    Quantiles,
    SensorReport,
    Severity,
    State,
    StateReport,
    StopWord,
)

ONLINE = b"online"
OFFLINE = b"offline"


class StateMessage(msgspec.Struct, frozen=True):
    """Payload of `state`; `time` is when it last changed."""

    state: State
    mode: Mode
    controller: Mode
    reason: str
    enabled: bool
    setpoint: float
    waveform: Waveform | None
    pole: float
    trip: str | None
    shutting_down: bool
    stop: StopWord | None
    clock: Synchronisation
    time: datetime


class SensorMessage(msgspec.Struct, frozen=True):
    """One sensor bus in `telemetry/drive`; values and their ages by name."""

    up: bool
    detail: str
    values: dict[str, float]
    age_s: dict[str, float]
    bus: dict[str, int]


class DriveMessage(msgspec.Struct, frozen=True):
    """Payload of `telemetry/drive`; measured values are null before the first measurement."""

    time: datetime
    boost_voltage_V: float | None
    line_voltage_V: float | None
    load_power_W: float | None
    output: float | None
    age_s: float
    command: Command
    ticks: int
    missed: int
    held: int
    limited: int
    lateness_us: Quantiles
    turnaround_us: Quantiles
    tick_us: Quantiles
    histograms: Mapping[str, tuple[int, ...]]
    bus: dict[str, int]
    sensors: dict[str, SensorMessage]


class EventMessage(msgspec.Struct, frozen=True):
    """Payload of `event`."""

    time: datetime
    kind: str
    severity: Severity
    detail: str
    tick: int


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


def encode(message: msgspec.Struct | dict[str, Any]) -> bytes:
    """The JSON text of a message."""
    return msgspec.json.encode(message)


def state_message(report: StateReport, clock: Synchronisation, time: datetime) -> StateMessage:
    """The payload of `state` for a report that was true from `time` on."""
    return StateMessage(
        state=report.state,
        mode=report.mode,
        controller=report.controller,
        reason=report.reason,
        enabled=report.enabled,
        setpoint=report.setpoint,
        waveform=report.waveform,
        pole=report.pole,
        trip=report.trip,
        shutting_down=report.shutting_down,
        stop=report.stop,
        clock=clock,
        time=time,
    )


def load_message(report: LoadReport, time: datetime) -> dict[str, Any]:
    """Return the payload of `telemetry/load` for a report that arrived at `time`."""
    return {"time": time} | {column.name: column.read(report) for column in SLOW_COLUMNS}


def sensor_message(report: SensorReport) -> SensorMessage:
    """A sensor bus as `telemetry/drive` shows it."""
    return SensorMessage(
        up=report.up,
        detail=report.detail,
        values=report.values,
        age_s=report.age_s,
        bus=report.bus,
    )


def drive_message(report: DriveReport, time: datetime) -> DriveMessage:
    """The payload of `telemetry/drive` for a report that arrived at `time`."""
    measured = report.measurement
    return DriveMessage(
        time=time,
        boost_voltage_V=measured.boost_voltage_V if measured else None,
        line_voltage_V=measured.line_voltage_V if measured else None,
        load_power_W=measured.load_power_W if measured else None,
        output=measured.output if measured else None,
        age_s=report.age_s,
        command=report.command,
        ticks=report.ticks,
        missed=report.missed,
        held=report.held,
        limited=report.limited,
        lateness_us=report.lateness_us,
        turnaround_us=report.turnaround_us,
        tick_us=report.tick_us,
        histograms=report.histograms,
        bus=report.bus,
        sensors={sensor.name: sensor_message(sensor) for sensor in report.sensors},
    )


def event_message(event: Event, time: datetime) -> EventMessage:
    """The payload of `event` for something that was reported at `time`."""
    return EventMessage(
        time=time,
        kind=event.kind,
        severity=event.severity,
        detail=event.detail,
        tick=event.tick,
    )
