"""The contract: payloads of the daemon, topics of a drive, and those of a simulated device.

A payload holds the fields of a report, as `runtime/reports.py` documents them. It is JSON in SI
units with RFC 3339 times in UTC. JSON has neither NaN nor infinity: the encoder writes null.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import msgspec

from adaptdrive.control.signals import Mode
from adaptdrive.mqtt.commands import STOP
from adaptdrive.runtime import reports
from adaptdrive.safety.trips import TripKind, remedy
from adaptdrive.util.quantity import BOOST, MEASURED, Display, Given
from adaptdrive.util.trends import HealthReport

Range = tuple[float | None, float | None]
"""Lowest and highest value, None where there is no limit."""


@dataclass(frozen=True, slots=True)
class Output:
    """The regulated quantity.

    Attributes:
        name: Its name, such as `speed`.
        unit: Unit of output, reference and set-point; empty for a plain number.
        display: Unit in which people see and type it: scale · value + offset. None for its own.
    """

    name: str = "output"
    unit: str = ""
    display: Display | None = None

    @property
    def shown(self) -> Display:
        """Unit in which people see and type it."""
        return self.display or Display(self.unit)


@dataclass(frozen=True, slots=True)
class Profile:
    """The constant part of `state`.

    Attributes:
        drive: Name of the drive.
        output: Name and unit of the regulated quantity.
        limits: Lowest and highest values: of `setpoint` and `output_trip` in the unit of the
            output, of `pole`, of `boost_V`, `boost_trip_V`, `power_W` and, for a waveform,
            `period_s`.
        modes: Modes that an operator can choose.
        version: Version of the daemon.
        manipulated: Name and unit of what the drive is commanded, and gives.
        quantities: Quantities of `health`, not published in `state`.
    """

    drive: str
    output: Output = Output()
    limits: Mapping[str, Range] | None = None
    modes: tuple[Mode, ...] = tuple(Mode)
    version: str = ""
    manipulated: Given = BOOST
    quantities: tuple[str, ...] = ()


if TYPE_CHECKING:
    from _typeshed import DataclassInstance

NO_TRIP = "none"
"""Kind of the trip in `telemetry/drive` while there is none: what stores series of numbers takes no
notice of null, and would keep the last kind."""

ONLINE = b"online"
OFFLINE = b"offline"

Payload = dict[str, Any]


class Reply(msgspec.Struct, frozen=True):
    """Payload of `reply`.

    Attributes:
        id: Id of the command; a number only where a malformed command had one, None where none
            can be read.
        verb: What was asked.
        accepted: Whether it was carried out.
        reason: Why not; empty when it was.
        state: State of the drive afterwards, None while it is not known yet.
        trip_kind: Kind of the trip, or of the standing cause of one, for which it was refused; None
            for any other reason. A later version may have more kinds than are known here.
    """

    id: str | int | None
    verb: str
    accepted: bool
    reason: str
    state: reports.State | None
    trip_kind: str | None = None


class Synchronisation(StrEnum):
    """Synchronisation of the wall clock with a time source."""

    SYNCHRONISED = "synchronised"
    UNSYNCHRONISED = "unsynchronised"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class LastTrip:
    """The last trip, of this run of the daemon or of an earlier one.

    Attributes:
        time: Time of the trip.
        kind: Kind of the trip, None for one of a daemon that has other kinds.
        text: Text of the trip.
        remedy: Steps that remove its cause, before `reset`; empty for an unknown kind.
    """

    time: datetime
    kind: TripKind | None
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


def state_message(report: reports.StateReport, standing: Standing, profile: Profile) -> Payload:
    """Return the payload of `state`."""
    return _fields(report) | _fields(standing) | _fields(profile, "quantities")


def load_message(report: reports.LoadReport, time: datetime, output: Output) -> Payload:
    """Return the payload of `telemetry/load` for a report that arrived at `time`."""
    columns = {column.name: column.read(report) for column in reports.SLOW_COLUMNS}
    return {"time": time} | columns | _named(output)


def health_message(report: HealthReport) -> Payload:
    """Return the payload of `health`."""
    return _fields(report)


def histogram_message(report: reports.DriveReport, time: datetime) -> Payload:
    """Return the payload of `telemetry/histograms` for a report that arrived at `time`."""
    return {"time": time} | dict(report.histograms)


def drive_message(
    report: reports.DriveReport, time: datetime, output: Output, trip: TripKind | None = None
) -> Payload:
    """Return the payload of `telemetry/drive` for a report that arrived at `time`.

    Args:
        report: The fast loop.
        time: When it arrived.
        output: The regulated quantity.
        trip: Kind of the latched trip, None when not tripped.
    """
    measured = {name: getattr(report.measurement, name, None) for name in MEASURED}
    sensors = {one.name: _fields(one, "name") for one in report.sensors}
    whole = _fields(report, "measurement", "sensors", "histograms", "time_s")
    others = {"sensors": sensors, "trip_kind": trip or NO_TRIP}
    return {"time": time} | measured | whole | others | _named(output)


def last_trip(time: datetime, event: reports.Event) -> LastTrip:
    """Return a trip by its event."""
    return LastTrip(time, event.trip_kind, event.detail, remedy(event.trip_kind))


def event_message(event: reports.Event, time: datetime) -> Payload:
    """Return the payload of `event` for something that was reported at `time`."""
    return {"time": time} | _fields(event) | {"remedy": remedy(event.trip_kind)}


def _named(output: Output) -> Payload:
    return {"output_name": output.name, "output_unit": output.unit}


def _fields(report: DataclassInstance, *left_out: str) -> Payload:
    names = (field.name for field in dataclasses.fields(report))
    return {name: getattr(report, name) for name in names if name not in left_out}


# Topics of a drive, and of a simulated device.

ROOT = "adaptdrive"
SIMULATED = "adaptdrive-sim"


class Topics:
    """The topics of one drive.

    Attributes:
        availability: `online` or `offline`, retained; also the last will.
        state: The state as operators see it, retained.
        load_telemetry: One message per slow period, the last one retained.
        drive_telemetry: The fast loop, at most ten messages a second.
        histograms: Counts of all times of ticks since the start, retained.
        health: What the load was over the weeks, retained.
        ask_history: Request for the slow steps of the last hour; its payload has no meaning.
        history: Answers to such requests, for every client.
        event: Trips, mode changes, fallbacks, bus loss and return.
        reply: Answers to commands.
        commands: Filter that catches every command, those with an unknown verb too.
        probe: Topic among the commands that the daemon itself publishes on, and hears.
        stop: The topic of the command that stops the drive.
    """

    def __init__(self, drive: str) -> None:
        """Name the topics of a drive by its name, as in its configuration."""
        self._root = f"{ROOT}/{drive}/"
        self.availability = f"{self._root}availability"
        self.state = f"{self._root}state"
        self.load_telemetry = f"{self._root}telemetry/load"
        self.drive_telemetry = f"{self._root}telemetry/drive"
        self.histograms = f"{self._root}telemetry/histograms"
        self.health = f"{self._root}health"
        self.ask_history = f"{self._root}ask/history"
        self.history = f"{self._root}history"
        self.event = f"{self._root}event"
        self.reply = f"{self._root}reply"
        self.commands = self.command("#")
        self.probe = self.command("probe")
        self.stop = self.command(STOP)

    def command(self, verb: str) -> str:
        """The topic on which a verb is asked for."""
        return f"{self._root}command/{verb}"

    def verb(self, topic: str) -> str:
        """The verb that a command topic names, known or not."""
        return topic.removeprefix(self.command("")[:-1]).removeprefix("/")


TRUTH, DISTURB, REPLY = "truth", "disturb", "reply"


class Feature(msgspec.Struct, frozen=True):
    """A disturbance that the device offers to its operators.

    Attributes:
        text: What it does, in words.
        request: Payload of `disturb` without its id.
    """

    text: str
    request: dict[str, float]


class DeviceReply(msgspec.Struct, frozen=True):
    """The answer to one request.

    Attributes:
        id: Id of the request, None where none could be read.
        accepted: Whether it was carried out.
        reason: Why not; empty when it was.
    """

    id: str | None
    accepted: bool
    reason: str


def simulator_topic(drive: str, leaf: str) -> str:
    """Return a topic of a simulated device.

    Args:
        drive: Name of the drive.
        leaf: `truth`, `disturb` or `reply`.
    """
    return f"{SIMULATED}/{drive}/{leaf}"
