"""Discovery message for Home Assistant: one retained message makes the drive a device there.

The keys are those of Home Assistant's MQTT discovery of devices. What Home Assistant may do is what
its own user of the broker may do. Its client sends what a loss of the broker has left without an
acknowledgement again, after any time: each command but a stop expires.
"""

from __future__ import annotations

from adaptdrive.mqtt.contract import Payload, Profile, Topics
from adaptdrive.runtime.reports import State

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
    "K": "temperature_delta",  # a rise above the inflow; `temperature` would be converted to °C
}
_LAST_TRIP = (  # a state in Home Assistant has at most 255 characters
    "{{ value_json.last_trip.text[:255] if value_json.last_trip else 'none' }}"
)
_ANSWER = (  # to a command of Home Assistant; that to another client's leaves it as it is
    "{% if (value_json.id | string).startswith('ha-') %}"
    "{{ 'none' if value_json.accepted else (value_json.verb ~ ': ' ~ value_json.reason)[:255] }}"
    "{% else %}{{ this.state if this is defined else 'none' }}{% endif %}"
)
_ID = '"id": "ha-{{ now().timestamp() }}"'
_EXPIRING = (  # a sum in local time is an hour wrong in the hour that autumn repeats
    f'{_ID}, "expires": "{{{{ (utcnow() + timedelta(seconds=5)).isoformat() }}}}"'
)


def discovery(profile: Profile, prefix: str) -> tuple[str, Payload]:
    """Return the topic and the payload of the discovery message of a drive, which is retained.

    Args:
        profile: Name, unit and limits of the drive.
        prefix: Prefix of discovery topics, as Home Assistant is configured.
    """
    topics, key = Topics(profile.drive), f"adaptdrive-{profile.drive}"
    components = _sensors(profile, topics) | _controls(profile, topics)
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


def _sensors(profile: Profile, topics: Topics) -> dict[str, Payload]:
    output, given = profile.output, profile.manipulated
    drive = topics.drive_telemetry  # published in standby, too
    return {
        "output": _measured(output.name, drive, "output", output.unit),
        "boost_reference": _measured(
            given.asked, topics.load_telemetry, "boost_reference_V", given.unit
        ),
        "applied": _measured(given.title, drive, "boost_voltage_V", given.unit),
        "state": _shown("state", topics.state, "{{ value_json.state }}")
        | {"device_class": "enum", "options": [state.value for state in State]},
        "controller": _shown("controller in force", topics.state, "{{ value_json.controller }}"),
        "tripped": _shown("trip", topics.state, "{{ 'ON' if value_json.trip else 'OFF' }}")
        | {"platform": "binary_sensor", "device_class": "problem"},
        "refused": _shown("refused command", topics.reply, _ANSWER),
        "last_trip": _shown("last trip", topics.state, _LAST_TRIP)
        | {
            "json_attributes_topic": topics.state,
            "json_attributes_template": "{{ (value_json.last_trip or {}) | tojson }}",
        },
    }


def _shown(name: str, topic: str, template: str) -> Payload:
    """Return a sensor that shows a part of a topic."""
    return {
        "platform": "sensor",
        "name": name,
        "state_topic": topic,
        "value_template": template,
    }


def _measured(name: str, topic: str, key: str, unit: str) -> Payload:
    sensor = _shown(name, topic, f"{{{{ value_json.{key} }}}}") | {"state_class": "measurement"}
    if unit:
        sensor["unit_of_measurement"] = unit
    if unit in _DEVICE_CLASSES:
        sensor["device_class"] = _DEVICE_CLASSES[unit]
    return sensor


def _controls(profile: Profile, topics: Topics) -> dict[str, Payload]:
    low, high = (profile.limits or {}).get("setpoint", (None, None))
    controls: dict[str, Payload] = {
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
        controls["setpoint"] = _shown("set-point", topics.state, "{{ value_json.setpoint }}") | {
            "platform": "number",
            "min": low,
            "max": high,
            "step": max(_SMALLEST_STEP, (high - low) / _STEPS),
            "mode": "box",
            "command_topic": topics.command("setpoint"),
            "command_template": f'{{{_EXPIRING}, "value": {{{{ value }}}}}}',
        }
        if profile.output.unit:
            controls["setpoint"]["unit_of_measurement"] = profile.output.unit
    return controls


def _button(name: str, topic: str, content: str) -> Payload:
    return {
        "platform": "button",
        "name": name,
        "command_topic": topic,
        "command_template": f"{{{content}}}",
    }
