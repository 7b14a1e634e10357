"""The daemon's side of the MQTT contract: reports go out, commands come in.

The keys are those of Home Assistant's MQTT discovery of devices. What Home Assistant may do is what
its own user of the broker may do. Its client sends what a loss of the broker has left without an
acknowledgement again, after any time: each command but a stop expires.
"""

import asyncio
import ctypes
import json
import random
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from aiomqtt import Will

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt import commands, connection, contract, desk, publisher, steady
from adaptdrive.mqtt.session import BrokerSession
from adaptdrive.runtime import reports
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.clock import repeat
from adaptdrive.util.quantity import Display

# Discovery message for Home Assistant: one retained message makes the drive a device there.

_STEPS = 1000
_SMALLEST_STEP = 1e-3
"""Home Assistant leaves a control with a smaller one out."""

_DEVICE_CLASSES = {
    "V": "voltage",
    "mV": "voltage",
    "A": "current",
    "mA": "current",
    "W": "power",
    "kW": "power",
    "Hz": "frequency",
    "°C": "temperature",
    "°F": "temperature",
    "K": "temperature_delta",  # a rise above the inflow; `temperature` would be converted to °C
}
_LAST_TRIP = (  # a state in Home Assistant has at most 255 characters
    "{{ value_json.last_trip.text[:255] if value_json.last_trip else 'none' }}"
)
_PROGRAM = "{{ value_json.program.text[:255] if value_json.program else 'none' }}"
_ANSWER = (  # to a command of Home Assistant; that to another client's leaves it as it is
    "{% if (value_json.id | string).startswith('ha-') %}"
    "{{ 'none' if value_json.accepted else (value_json.verb ~ ': ' ~ value_json.reason)[:255] }}"
    "{% else %}{{ this.state if this is defined else 'none' }}{% endif %}"
)
_ID = '"id": "ha-{{ now().timestamp() }}"'
_EXPIRING = (  # a sum in local time is an hour wrong in the hour that autumn repeats
    f'{_ID}, "expires": "{{{{ (utcnow() + timedelta(seconds=5)).isoformat() }}}}"'
)


def discovery(profile: contract.Profile, prefix: str) -> tuple[str, contract.Payload]:
    """Return the topic and the payload of the discovery message of a drive, which is retained.

    Args:
        profile: Name, unit and limits of the drive.
        prefix: Prefix of discovery topics, as Home Assistant is configured.
    """
    topics, key = contract.Topics(profile.drive), f"adaptdrive-{profile.drive}"
    components = _sensors(profile, topics) | _health(profile, topics)
    components |= _controls(profile, topics)
    for name, component in components.items():
        component["unique_id"] = f"{key}-{name}"
    payload = {
        "device": {
            "identifiers": [key],
            "name": profile.drive,
            "manufacturer": "adaptdrive",
            "sw_version": profile.version,
        },
        "origin": {"name": "adaptdrive", "sw_version": profile.version},
        "availability_topic": topics.availability,
        "qos": 1,
        "components": components,
    }
    return f"{prefix}/device/{key}/config", payload


def _sensors(profile: contract.Profile, topics: contract.Topics) -> dict[str, contract.Payload]:
    output, shown, given = profile.output, profile.output.shown, profile.manipulated
    drive = topics.drive_telemetry  # published in standby, too
    return {
        "output": _measured(output.name, drive, "output", shown.unit)
        | {"value_template": _shown_by(shown, "value_json.output")},
        "boost_reference": _measured(
            given.asked, topics.load_telemetry, "boost_reference_V", given.unit
        ),
        "applied": _measured(given.title, drive, "boost_voltage_V", given.unit),
        "state": _shown("state", topics.state, "{{ value_json.state }}")
        | {"device_class": "enum", "options": [state.value for state in reports.State]},
        "controller": _shown("controller in force", topics.state, "{{ value_json.controller }}"),
        "tripped": _shown("trip", topics.state, "{{ 'ON' if value_json.trip else 'OFF' }}")
        | {"platform": "binary_sensor", "device_class": "problem"},
        "trip_kind": _shown(
            "kind of trip", topics.state, f"{{{{ value_json.trip_kind or '{contract.NO_TRIP}' }}}}"
        )
        | {"device_class": "enum", "options": [contract.NO_TRIP, *TripKind]},
        "program": _shown("program", topics.state, _PROGRAM),
        "program_left": _measured("time left of the program", drive, "remaining_s", "s")
        | {"device_class": "duration"},
        "refused": _shown("refused command", topics.reply, _ANSWER),
        "last_trip": _shown("last trip", topics.state, _LAST_TRIP)
        | {
            "json_attributes_topic": topics.state,
            "json_attributes_template": "{{ (value_json.last_trip or {}) | tojson }}",
        },
    }


def _health(profile: contract.Profile, topics: contract.Topics) -> dict[str, contract.Payload]:
    """Return a sensor for each quantity of the load, and one of whether any is out of bounds."""
    if not profile.quantities:
        return {}
    outside = "value_json.quantities.values() | selectattr('outside') | list"
    found = {
        "health": _shown("health", topics.health, f"{{{{ 'ON' if {outside} else 'OFF' }}}}")
        | {"platform": "binary_sensor", "device_class": "problem"}
    }
    for name in profile.quantities:
        one = f"value_json.quantities.get('{name}', {{}})"
        sensor = _shown(name.replace("_", " "), topics.health, f"{{{{ {one}.get('value') }}}}")
        found[f"health-{name}"] = sensor | {
            "state_class": "measurement",
            "json_attributes_topic": topics.health,
            "json_attributes_template": f"{{{{ {one} | tojson }}}}",
        }
    return found


def _shown(name: str, topic: str, template: str) -> contract.Payload:
    """Return a sensor that shows a part of a topic."""
    return {
        "platform": "sensor",
        "name": name,
        "state_topic": topic,
        "value_template": template,
    }


def _measured(name: str, topic: str, key: str, unit: str) -> contract.Payload:
    sensor = _shown(name, topic, f"{{{{ value_json.{key} }}}}") | {"state_class": "measurement"}
    if unit:
        sensor["unit_of_measurement"] = unit
    if unit in _DEVICE_CLASSES:
        sensor["device_class"] = _DEVICE_CLASSES[unit]
    return sensor


def _controls(profile: contract.Profile, topics: contract.Topics) -> dict[str, contract.Payload]:
    low, high = (profile.limits or {}).get("setpoint", (None, None))
    shown = profile.output.shown
    controls: dict[str, contract.Payload] = {
        "stop": _button("stop", topics.stop, _ID),
        "reset": _button("reset trip", topics.command("reset"), _EXPIRING),
        # whoever wants to energise the drive from Home Assistant switches this one on there
        "enable": _button("enable", topics.command("enable"), _EXPIRING)
        | {"enabled_by_default": False},
        "mode": _shown("mode", topics.state, "{{ value_json.mode }}")
        | {
            "platform": "select",
            "options": [mode.value for mode in profile.modes],
            "command_topic": topics.command("mode"),
            "command_template": f'{{{_EXPIRING}, "value": "{{{{ value }}}}"}}',
        },
    }
    if low is not None and high is not None:
        controls["setpoint"] = _shown(
            "set-point", topics.state, _shown_by(shown, "value_json.setpoint")
        ) | {
            "platform": "number",
            "min": shown.shown(low),
            "max": shown.shown(high),
            "step": max(_SMALLEST_STEP, shown.change.shown(high - low) / _STEPS),
            "mode": "box",
            "command_topic": topics.command("setpoint"),
            "command_template": f'{{{_EXPIRING}, "value": {{{{ value }}}}{_marked(shown)}}}',
        }
        if shown.unit:
            controls["setpoint"]["unit_of_measurement"] = shown.unit
    return controls


def _shown_by(display: Display, place: str) -> str:
    """Return the template that shows a value of the output, unknown as it is."""
    if display.mark is None:
        return f"{{{{ {place} }}}}"
    shown = f"{display.scale!r} * {place} + {display.offset!r}"
    return f"{{{{ none if {place} is none else {shown} }}}}"


def _marked(display: Display) -> str:
    """Return the part of a command that names the unit of what was typed."""
    return "" if display.mark is None else f', "unit": {json.dumps(display.mark)}'


def _button(name: str, topic: str, content: str) -> contract.Payload:
    return {
        "platform": "button",
        "name": name,
        "command_topic": topic,
        "command_template": f"{{{content}}}",
    }


# The daemon's side of the MQTT contract: reports go out, commands come in.

CLOCK_CHECK_S = 10.0
COMMAND_PATIENCE_S = 1.0
"""Longest wait of a command for the disk: one that hangs must not keep an operator from acting."""


# struct timex takes 208 bytes on 64-bit kernels; more room does no harm, zeros ask and set nothing.
_TIMEX_BYTES = 512
_TIME_ERROR = 5


def kernel_synchronisation() -> contract.Synchronisation:
    """Ask the kernel whether its clock is kept right by NTP, PTP or a radio clock."""
    try:
        answer = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):
        answer = -1
    if answer < 0:
        return contract.Synchronisation.UNKNOWN
    if answer == _TIME_ERROR:
        return contract.Synchronisation.UNSYNCHRONISED
    return contract.Synchronisation.SYNCHRONISED


@dataclass(frozen=True, slots=True)
class OperatorLog:
    """The log as the service sees it, by default one that keeps nothing, and clocks and chance.

    Attributes:
        replies: Replies of earlier runs, the oldest first.
        events: Time and contents of the events that the broker does not have, the oldest first.
        trip: Time and event of the last trip, None before the first.
        note_reply: Has a reply kept by its id.
        note_sent: Has it kept that the broker has the oldest event.
        kept: Waits until the disk keeps what was noted and published, for a longest time in s.
        wall: Wall clock in UTC.
        monotonic: Clock for intervals, in seconds.
        synchronisation: Returns whether the wall clock can be trusted.
        uniform: Random number between its arguments, for the back-off.
    """

    replies: Sequence[desk.Recalled] = ()
    events: Sequence[tuple[datetime, reports.Event]] = ()
    trip: tuple[datetime, reports.Event] | None = None
    note_reply: Callable[[str, bytes], None] = lambda _identity, _body: None
    note_sent: Callable[[], None] = lambda: None
    kept: Callable[[float], Awaitable[None]] = reports.wait_for_nothing
    wall: Callable[[], datetime] = lambda: datetime.now(UTC)
    monotonic: Callable[[], float] = time.monotonic
    synchronisation: Callable[[], contract.Synchronisation] = kernel_synchronisation
    uniform: Callable[[float, float], float] = random.uniform


def broker_of(settings: Mqtt) -> connection.Broker:
    """Return the broker of a section `[mqtt]`."""
    address = settings.host, settings.port, settings.tls, settings.ca_file
    return connection.Broker(*address, settings.username, settings.password_file)


class MqttService:
    """Publishes one drive on a broker and answers its operators."""

    def __init__(
        self,
        profile: contract.Profile,
        settings: Mqtt,
        host: commands.Host,
        hub: reports.Hub,
        surroundings: OperatorLog,
    ) -> None:
        """Subscribe to the hub: nothing is missed between now and `run`.

        Args:
            profile: Name, unit and limits of the drive.
            settings: Section `[mqtt]`.
            host: Carries commands out.
            hub: Where the runtime's reports come from.
            surroundings: Log, clocks and chance.
        """
        drive = profile.drive
        self._topics = contract.Topics(drive)
        self._announcement = (
            discovery(profile, settings.home_assistant) if settings.home_assistant else None
        )
        self._telemetry_s = 1.0 / settings.telemetry_Hz
        self._around = surroundings
        self._host = host
        tripped, wall = surroundings.trip, surroundings.wall
        trip = contract.last_trip(*tripped) if tripped else None
        self._board = publisher.StateBoard(wall, profile, trip)
        unsent = (
            contract.encode(contract.event_message(event, time))
            for time, event in surroundings.events
        )
        outbox = publisher.Outbox(unsent, surroundings.note_sent)
        history = publisher.History(surroundings.monotonic)
        self._intake = publisher.Intake(hub, self._board, outbox, history, wall, profile.output)
        self._desk = self._build_desk(hub)
        name, alarm = f"adaptdrive-{drive}", self._intake.report_other
        self._name = connection.ClientName(name, surroundings.monotonic, alarm, host.trip)
        will = Will(self._topics.availability, contract.OFFLINE, qos=1, retain=True)
        self._link = connection.BrokerLink(
            broker_of(settings), self._name, will, surroundings.uniform
        )

    def _build_desk(self, hub: reports.Hub) -> desk.Desk:
        around = self._around
        return desk.Desk(
            self._host,
            desk.ReplyMemory(around.replies, around.note_reply, around.monotonic),
            lambda: self._board.state,
            around.wall,
            desk.LineRation(around.monotonic),
            report=hub.publish,
            kept=lambda: around.kept(COMMAND_PATIENCE_S),
            shutting_down=lambda: self._board.shutting_down,
        )

    async def run(self) -> None:
        """Serve until cancelled, with a broker or without."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._intake.run(), name="mqtt intake")
            tasks.create_task(repeat(self._read_clock, CLOCK_CHECK_S), name="mqtt clock")
            tasks.create_task(self._desk.run(), name="mqtt desk")
            tasks.create_task(self._link.run(self._serve), name="mqtt link")

    async def _read_clock(self) -> None:
        self._board.show_clock(self._around.synchronisation())

    async def _serve(self, client: steady.SteadyClient) -> None:
        session = BrokerSession(
            client, self._name, self._topics, self._intake, self._desk, self._telemetry_s
        )
        await session.run(self._announcement)
