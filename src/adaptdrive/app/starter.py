"""A first configuration of a drive, composed from the shipped examples.

An example describes one load behind one bus. The bus of one and the load of another make the
configurations that no example shows; every one of them passes `check` as it stands.
"""

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from typing import Literal

from adaptdrive.config import services
from adaptdrive.config.load import LoadName
from adaptdrive.config.section import si_unit
from adaptdrive.util.errors import ConfigurationError, Flaw, nearest

BusName = Literal["can", "modbus-tcp", "modbus-rtu", "canopen", "scpi"]

_POLLED = ("modbus-tcp", "modbus-rtu", "scpi")
_POLL_TICKS = 12  # as in the examples of polled drives
_LONG_STRIDE = 2  # the examples' six ticks are three readings of such a drive
_TICK_S = 1.0 / 120.0
_THREE_TICKS_S = 3.0 * _TICK_S
_LEAST_READINGS = 10  # of a drive in one slow period
_SHARED = (
    ("command_timeout_s", 1.0, "of the simulated drive; a real one: its own parameter"),
    ("stale_s", 0.5, "a shared machine is late by this much; on a real bus three readings"),
)
_AMPERES = 'unit = "A", range = { low = -80.0, high = 80.0 } }'
_OUTPUTS: Mapping[str, str] = {
    "battery-modbus-tcp": 'current = { address = 19, table = "holding", type = "int32", '
    f"scale = 1.0e-4, {_AMPERES}",
    "battery-modbus-rtu": 'current = { address = 4, table = "input", type = "float32", '
    f'order = "CDAB", {_AMPERES}',
    "battery-scpi": f'current = {{ query = "MEAS:CURR?", {_AMPERES}',
    "bath-scpi": 'temperature = { query = "MEAS:TEMP?", unit = "K" }  # above the inflow',
}
"""Outputs of loads that no example has on a bus, in place of the tachometer."""

_HEAD = """\
# A {load} behind a drive on {bus}. Adapt each value to your own drive and load, then validate this
# file with `adaptdrive check`. A key that is not named here has the default that `adaptdrive
# schema` shows.

"""


Starter = tuple[str, dict[str, bytes]]
"""A first configuration as TOML, and the DBC or EDS that it names with its content, if any."""


def compose(load: LoadName, bus: BusName, name: str, bus_part: str | None = None) -> Starter:
    """Return a commented configuration that passes `check`.

    Args:
        load: Kind of load.
        bus: Kind of bus.
        name: Name of the drive.
        bus_part: `[bus]` and `[signals]` of a drive other than the reference drive, with the
            `[voltage_loop]` that fits; None for the reference drive.
    """
    load_text, bus_text = _example(f"{load}.toml"), _bus_example(load, bus)
    ticks = re.search(r"(?m)^clock_ticks = (\d+)", bus_part or "")
    stride = int(ticks[1]) if ticks else 1
    text = "".join(
        (
            _HEAD.format(load=load, bus=bus),
            _named(_between(load_text, "[drive]", "[bus]"), name),
            bus_part or _between(bus_text, "[bus]", "[load]"),
            _with_output_unit(
                _load_part(load_text, _POLL_TICKS if bus in _POLLED else stride, _TICK_S),
                bus_part or "",
            ),
            _with_stale_limit(load_text[load_text.index("[interlocks]") :], bus_text, stride),
        )
    )
    if bus_part:
        return marked(text), {}
    return _starter(marked(_for_a_shared_machine(text)), "examples")


def device_names() -> list[str]:
    """Return the names of the devices that come with a description."""
    files = (resources.files("adaptdrive") / "described").iterdir()
    return sorted(one.name.removesuffix(".toml") for one in files if one.name.endswith(".toml"))


def of_device(load: LoadName, device: str, name: str, own: str | None = None) -> Starter:
    """Return the configuration of a device, which passes `check` with the load of its description.

    Args:
        load: Kind of load; one that the device is not described with is that of the example, whose
            output the signals of the device do not give yet.
        device: Name of the device.
        name: Name of the drive.
        own: Path of a DBC or EDS of the user, in place of the one that comes with the device.

    Raises:
        ConfigurationError: There is no such device, or it has no such file.
    """
    known = device_names()
    if device not in known:
        problem = f"is none of {', '.join(known)}{nearest(device, known)}"
        raise ConfigurationError("--device", [Flaw(device, problem)])
    text = _read(f"{device}.toml", "described").decode("utf-8")
    tables = tomllib.loads(text)
    if tables["load"]["type"] != load:
        text = _with_load(text, load)
    text = answered(_named(text, name), dict.fromkeys(_MARKED - {"bus.command_timeout_s"}, ""))
    if own is None:
        return _starter(text, "described")
    key = "eds" if own.lower().endswith((".eds", ".dcf")) else "database"
    if key not in tables["bus"]:
        raise ConfigurationError("--device", [Flaw(device, f"has no bus.{key}, as {own} is")])
    line = f"{key} = {quoted(own)}"
    return re.sub(rf"(?m)^{key} = .*$", lambda _: line, text), {}


def _with_load(text: str, load: LoadName) -> str:
    """Return the description of a device with the load and the highest output of an example."""
    device, example = tomllib.loads(text), _example(f"{load}.toml")
    stride = device["bus"].get("poll_ticks") or device["bus"].get("clock_ticks", 1)
    part = _load_part(example, stride, 0.5 / device["drive"]["line_frequency_Hz"])
    highest = re.search(r"(?m)^output_max = .*$", example)[0]  # type: ignore[index]
    interlocks = re.sub(r"(?m)^output_max = .*$", highest, text[text.index("[interlocks]") :])
    text = text[: text.index("[load]")] + part + interlocks
    remark = f"# {_MARK} it must give the output of the {load}"
    outputs = {
        key: f"{found['value']}  {remark}"
        for key, _, found in _lines(text)
        if found and key in _OUTPUT_KEYS
    }
    return answered(text, outputs)


def _starter(text: str, folder: str) -> Starter:
    """Return a configuration with the file that its bus names."""
    bus = tomllib.loads(text)["bus"]
    file = bus.get("database") or bus.get("eds")
    return text, {file: _read(file, folder)} if file else {}


def _for_a_shared_machine(text: str) -> str:
    """Return the configuration of the reference drive, which is simulated, with limits that fit.

    A real drive on a real bus has the limits of the examples, and longer ones stay.
    """
    for key, value, remark in _SHARED:
        stated = re.search(rf"(?m)^{key} = ([\d.]+)", text)
        if stated and float(stated[1]) < value:
            text = _with(text, key, str(value), remark)
    return text


def _with(text: str, key: str, value: str, remark: str) -> str:
    """Return a text in which a key has another value, with a remark."""
    line = f"{key} = {value:<{24 - len(key)}}# {remark}"
    return re.sub(rf"(?m)^{key} = .*$", line, text)


def quoted(text: str) -> str:
    """Return a text as TOML writes it, whatever its characters are."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _read(file: str, folder: str) -> bytes:
    return (resources.files("adaptdrive") / folder / file).read_bytes()


def _example(file: str) -> str:
    return _read(file, "examples").decode("utf-8")


def _bus_example(load: LoadName, bus: BusName) -> str:
    """Return the example of a drive on this bus, with the output of this load."""
    if bus == "can":
        return _example(f"{load}.toml")
    if bus == "canopen":
        return _example("motor-cia402.toml")
    output = _OUTPUTS.get(f"{load}-{bus}")
    if output is None:
        return _example(f"{load}-{bus}.toml")
    text = re.sub(r"(?m)^tachometer = \{.*\}", output, _example(f"motor-{bus}.toml"))
    return text.replace('output = "tachometer"', f'output = "{output.partition(" ")[0]}"')


def _between(text: str, first: str, last: str) -> str:
    """Return the sections from `first` up to, without, `last`."""
    return text[text.index(f"\n{first}") + 1 : text.index(f"\n{last}") + 1]


def _named(section: str, name: str) -> str:
    return re.sub(r'(?m)^name = "[^"]*"', f'name = "{name}"', section, count=1)


def _load_part(load_text: str, stride: int, tick_s: float) -> str:
    """Return `[load]` and what follows, with a slow period of whole readings."""
    section = _between(load_text, "[load]", "[interlocks]")
    if stride == 1:
        return section
    period_s = float(re.search(r"(?m)^period_s = ([\d.]+)", section)[1])  # type: ignore[index]
    readings = max(_LEAST_READINGS, round(period_s / (stride * tick_s)))
    if not math.isclose(readings * stride * tick_s, period_s):
        whole = f"{readings * stride * tick_s:.6g}"
        section = _with(section, "period_s", whole, f"{readings} readings")
    latency = f"latency_ticks = {stride:<20}# one reading from the slow sample to its effect"
    return section.replace("\nreference_min", f"\n{latency}\nreference_min", 1)


def _with_output_unit(section: str, bus_part: str) -> str:
    """Return `[load]` for an output in another unit than that of the example."""
    stated = re.search(r"(?m)^output = .*  # ([^,\n]+)", bus_part)
    unit = si_unit(stated[1]) if stated else None
    if unit is None or f'\noutput_unit = "{unit}"' in section:
        return section
    remark = "signals.output is converted to it: adapt range, model and limits"
    return _with(section, "output_unit", f'"{unit}"', remark)


def _with_stale_limit(section: str, bus_text: str, stride: int) -> str:
    """Return `[interlocks]` and what follows, with the stale limit that fits the bus."""
    if stride > _LONG_STRIDE:
        limit = f"{min(stride * _THREE_TICKS_S, services.LONGEST_STALE_S):.4g}"
        return _with(section, "stale_s", limit, "three readings")
    stated = re.search(r"(?m)^stale_s = .*$", bus_text)
    return re.sub(r"(?m)^stale_s = .*$", stated[0], section) if stated else section


QUESTIONS = {
    "drive.line_frequency_Hz": "frequency of the line in Hz",
    "drive.line_voltage_V": "voltage of the line in V, rms",
    "drive.limits.boost_reference_min_V": "lowest voltage of the dc bus in V",
    "drive.limits.boost_reference_max_V": "highest voltage of the dc bus in V",
    "load.reference_min": "lowest set-point in the unit of the output",
    "load.reference_max": "highest set-point",
    "interlocks.output_max": "output above which the drive trips",
    "mqtt.host": "broker",
}
"""Questions of `init` by key, in the order in which it asks."""

_MARKED = QUESTIONS.keys() - {"mqtt.host"} | {
    "bus.host",
    "bus.device",
    "sensor_bus.host",
    "bus.command_timeout_s",
    "drive.boost_capacitance_F",
    "interlocks.boost_voltage_max_V",
}
"""Keys whose value in the example is that of one drive alone."""

_OUTPUT_KEYS = ("signals.output", "sensor_bus.signals.output", "derived.output.of")

_LINE = re.compile(r"(?P<key>\w+) = (?P<value>[^#\n]*?)(?P<gap>\s*)(# (?P<comment>.*))?$")
_MARK = "example:"


def examples(text: str) -> Iterator[tuple[str, str]]:
    """Yield key and value of each value of the example that is left.

    Args:
        text: A configuration.
    """
    for key, _, found in _lines(text):
        if found is not None and (found["comment"] or "").startswith(_MARK):
            yield key, found["value"]


def asked(text: str) -> dict[str, str]:
    """Return the values that `init` asks for, by key, as they stand in a configuration."""
    return {key: found["value"] for key, _, found in _lines(text) if found and key in QUESTIONS}


def marked(text: str) -> str:
    """Return a configuration whose values are marked as those of the example."""
    return answered(text, dict.fromkeys(_MARKED, ""))


def answered(text: str, answers: dict[str, str]) -> str:
    """Return a configuration with values by key, which are marked no longer.

    Args:
        text: The configuration.
        answers: Values, as TOML; an empty one marks the value that is there.
    """
    lines = (
        _line(found, answers[key]) if found and key in answers else line
        for key, line, found in _lines(text)
    )
    return "".join(f"{line}\n" for line in lines)


def _line(found: re.Match[str], value: str) -> str:
    """Return a line with another value, or marked where there is none."""
    if value:
        return f"{found['key']} = {value}"
    comment = found["comment"] or "adapt"
    return f"{found['key']} = {found['value']}{found['gap'] or '  '}# {_MARK} {comment}"


def _lines(text: str) -> Iterator[tuple[str, str, re.Match[str] | None]]:
    """Yield the key that each line sets, empty for none, the line, and its parts."""
    section = ""
    for line in text.splitlines():
        if line.startswith("["):
            section = line.partition("#")[0].strip("[] ")
        found = _LINE.match(line)
        yield (f"{section}.{found['key']}" if found else ""), line, found
