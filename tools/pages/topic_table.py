"""The topics of a drive and the types of their payloads, made from the reports that fill them."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, get_type_hints

import msgspec

from adaptdrive.control.signals import Estimate, Measurement
from adaptdrive.mqtt.commands import FORMS
from adaptdrive.mqtt.contract import (
    DISTURB,
    NO_TRIP,
    REPLY,
    SIMULATED,
    TRUTH,
    DeviceReply,
    Feature,
    Profile,
    Reply,
    Standing,
    Topics,
    simulator_topic,
)
from adaptdrive.mqtt.publisher import KEYS
from adaptdrive.runtime.reports import (
    SLOW_COLUMNS,
    DriveReport,
    Event,
    SensorReport,
    StateReport,
)
from adaptdrive.util.quantity import MEASURED, Column, columns_of
from adaptdrive.util.trends import HealthReport

Member = tuple[str, Any]
"""Name and type of a key, the type annotated with its meaning."""

_OUTPUT_UNIT = "unit of the output"
_KINDS: dict[type, Any] = {tuple: list[float], dict: dict[str, Estimate]}
_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.MULTILINE)


class Availability(StrEnum):
    """Connection of a daemon to the broker."""

    ONLINE = "online"
    OFFLINE = "offline"


class PlantTruth(msgspec.Struct, frozen=True):
    """The device's own state; besides these keys, true parameters and quantities of the plant.

    Attributes:
        time: Time of the message, UTC.
        features: Disturbances that the device offers.
    """

    time: str = ""
    features: tuple[Feature, ...] = ()


class PlantDisturbance(msgspec.Struct, frozen=True):
    """A request; besides its id, exactly one disturbance such as `disks`, as `features` lists them.

    Attributes:
        id: Id of the request, which the reply repeats.
    """

    id: Annotated[str, msgspec.Meta(min_length=1)]


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of each drive.

    Attributes:
        address: Topic, with `{drive}` for the name of the drive.
        summary: Contents, in a few words.
        payload: Type of the payload, which is JSON except on `availability`.
        sent: Whether the daemon publishes it; otherwise the daemon subscribes to it.
        retained: Whether the broker keeps the last message.
        qos: Quality of service.
    """

    address: str
    summary: str
    payload: Any
    sent: bool = True
    retained: bool = False
    qos: int = 1

    @property
    def name(self) -> str:
        """The topic below that of the drive; one of a simulated device below `simulator`."""
        root, _, name = self.address.split("/", 2)
        return f"simulator/{name}" if root == SIMULATED else name


def topics() -> tuple[Topic, ...]:
    """Return all topics of a drive."""
    of = Topics("{drive}")
    load, history = _load(), _history()
    return (
        Topic(
            of.availability,
            "connection of the daemon; also the last will",
            Availability,
            retained=True,
        ),
        Topic(of.state, "state, names, units and limits, on each change", _state(), retained=True),
        Topic(of.load_telemetry, "one slow step", load, retained=True, qos=0),
        Topic(of.drive_telemetry, "the fast loop, at most ten times a second", _drive(), qos=0),
        Topic(
            of.histograms, "times of all ticks since the start", _histograms(), retained=True, qos=0
        ),
        Topic(
            of.health,
            "what the load was over the weeks, each hour",
            _message("HealthMessage", "Health of the load.", (*_members(HealthReport),)),
            retained=True,
            qos=0,
        ),
        Topic(of.event, "a trip, a change of mode, a loss of a bus, …", _event()),
        Topic(of.reply, "the answer to a command", Reply),
        Topic(of.history, "a page of the slow steps of the last hour", history),
        Topic(of.ask_history, "a request for the history; any payload", Any, sent=False),
        *(
            Topic(of.command(verb), f"the command {verb}", FORMS[verb], sent=False)
            for verb in FORMS
        ),
    )


def simulator_topics() -> tuple[Topic, ...]:
    """Return all topics of a simulated device, beside those of its daemon."""

    def of(leaf: str) -> str:
        return simulator_topic("{drive}", leaf)

    return (
        Topic(
            of(TRUTH),
            "the simulated plant, once a second, and the disturbances that it offers",
            PlantTruth,
            retained=True,
            qos=0,
        ),
        Topic(of(REPLY), "the answer to a request", DeviceReply),
        Topic(of(DISTURB), "a request", PlantDisturbance, sent=False),
    )


def _state() -> type:
    members = (*_members(StateReport), *_members(Standing), *_members(Profile, "quantities"))
    return _message("StateMessage", "State of a drive, its names, units and limits.", members)


def _load() -> type:
    columns = (_column(column) for column in SLOW_COLUMNS)
    return _message("LoadMessage", "A slow step.", (_TIME, *columns, *_NAMED))


def _drive() -> type:
    left_out = ("measurement", "sensors", "histograms", "time_s")
    measured = [_column(one) for one in columns_of(Measurement) if one.name in MEASURED]
    sensor = _message("SensorMessage", "A sensor bus.", _members(SensorReport, "name"))
    sensors = ("sensors", Annotated[dict[str, sensor], _meaning("sensor buses by name")])  # type: ignore[valid-type]
    kind = ("trip_kind", Annotated[str, _meaning(f"kind of the latched trip, or `{NO_TRIP}`")])
    members = (_TIME, *measured, *_members(DriveReport, *left_out), sensors, kind, *_NAMED)
    return _message("DriveMessage", "The fast loop since the last message.", members)


def _histograms() -> type:
    counts = Annotated[
        list[int], _meaning("counts of times below 1, 2, 4, … 32,768 us, and longer")
    ]
    members = ((name, counts) for name in ("lateness_us", "turnaround_us", "tick_us"))
    return _message("HistogramsMessage", "Times of all ticks since the start.", (_TIME, *members))


def _event() -> type:
    remedy = ("remedy", Annotated[str, _meaning("steps that remove the cause of an alarm")])
    return _message("EventMessage", "An event.", (_TIME, *_members(Event), remedy))


def _history() -> type:
    columns = [_column(column) for column in SLOW_COLUMNS if column.name in KEYS]
    row = _message("HistoryRow", "A slow step, in short.", (_TIME, *columns))
    members = (
        _TIME,
        ("page", Annotated[int, _meaning("number of the page, from 1; the newest rows first")]),
        ("pages", Annotated[int, _meaning("pages of the answer")]),
        ("rows", Annotated[list[row], _meaning("slow steps")]),  # type: ignore[valid-type]
        (
            "readings",
            Annotated[
                list[tuple[float, float, float, float, float]],
                _meaning(
                    "time in seconds since 1970, output, boost voltage in V, set-point, and V_c"
                ),
            ],
        ),
    )
    return _message("HistoryMessage", "A page of the history.", members)


def _message(name: str, summary: str, members: Iterator[Member] | tuple[Member, ...]) -> type:
    return msgspec.defstruct(name, list(members), namespace={"__doc__": summary})


def _meaning(text: str) -> msgspec.Meta:
    return msgspec.Meta(description=text)


def _members(part: type, *left_out: str) -> Iterator[Member]:
    """Yield the fields of a dataclass with their meanings."""
    hints, meanings = get_type_hints(part), attributes(part.__doc__ or "")
    meanings |= {column.source: column.meaning for column in columns_of(part)}
    for field in dataclasses.fields(part):
        if field.name not in left_out:
            kind, meaning = hints[field.name], meanings.get(field.name, "")
            yield field.name, Annotated[_kind(kind), _meaning(meaning)]


@cache
def _kind(kind: Any) -> Any:
    """Return the type of a field in a message: dataclasses with the meanings of their fields."""
    if kind is datetime:
        return _AWARE
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        summary = (kind.__doc__ or "").partition("\n")[0]
        return _message(kind.__name__, summary, _members(kind))
    return kind


def _column(column: Column) -> Member:
    unit = {"y": f", {_OUTPUT_UNIT}", "u": ", unit of the load's input", "": ""}
    unit["v"] = ", unit of `manipulated` in `state`"
    text = column.meaning + unit.get(column.unit, f", {column.unit}")
    return column.name, Annotated[_KINDS.get(column.kind, column.kind), _meaning(text)]


def attributes(docstring: str) -> dict[str, str]:
    """Return the meanings of the attributes that a docstring lists.

    Args:
        docstring: Text with a section `Attributes:`, with the indentation of a class or none.
    """
    section = inspect.cleandoc(docstring).partition("Attributes:\n")[2]
    return {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(section)}


_AWARE = Annotated[datetime, msgspec.Meta(tz=True)]
_TIME: Member = ("time", Annotated[_AWARE, _meaning("time of the report, UTC")])
_NAMED: tuple[Member, ...] = (
    ("output_name", Annotated[str, _meaning("name of the output")]),
    ("output_unit", Annotated[str, _meaning(_OUTPUT_UNIT)]),
)
