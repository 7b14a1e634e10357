"""Status of a drive as text."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from adaptdrive.cli.explain import with_kind
from adaptdrive.mqtt import commands
from adaptdrive.mqtt.client import LIVE_S, DriveStatus
from adaptdrive.util.quantity import Display, Given

_FRACTION = re.compile(r"\.\d+(?=Z)")
_SILENT = (
    "online by the broker, but no telemetry came: the daemon may be gone, or this user may not "
    "read telemetry"
)


def describe(drive: str, status: DriveStatus) -> str:
    """Return the status of a drive in a few lines.

    Args:
        drive: Name of the drive.
        status: The messages that it published.
    """
    lines = [f"{drive} is {_SILENT if status.silent else commands.printable(status.availability)}"]
    state = status.state or {}
    shown, given = commands.display_in(state), commands.given_in(state)
    if status.state is not None:
        lines += _state(status.state, shown, live=status.online and status.live)
        program = commands.program_text(status.state, status.telemetry.get("drive", {}))
        lines += [_row("program", program)] if program else []
    if "load" in status.telemetry:
        lines += _load(status.telemetry["load"], _unit(state), shown, given)
    if "drive" in status.telemetry:
        lines += _drive(status.telemetry["drive"], shown, given)
    return "\n".join(lines)


def site_table(site: Mapping[str, DriveStatus]) -> str:
    """Return a table with a row for each drive, a tripped drive first, and the remedies below it.

    Args:
        site: What is known of each drive, by its name.
    """
    heads = ("drive", "state", "output", "set-point", "controller", "since", "trip")
    ordered = sorted(site, key=lambda name: (not (site[name].state or {}).get("trip"), name))
    rows = [heads, *(_site_row(name, site[name]) for name in ordered)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    cells = (
        [commands.printable(text).ljust(n) for text, n in zip(row, widths, strict=True)]
        for row in rows
    )
    lines = ["  ".join(row).rstrip() for row in cells]
    lines += [f"{name} is {_SILENT}" for name in ordered if site[name].silent]
    for name in ordered:
        state = site[name].state or {}
        remedy = commands.part(state, "last_trip").get("remedy")
        if remedy and state.get("trip"):
            advice = commands.printable(with_kind(str(remedy), state.get("trip_kind")))
            lines.append(f"{name}: what to do: {advice}")
    return "\n".join(lines)


def _unit(state: dict[str, Any]) -> str:
    """Return the unit of the output."""
    return str(commands.part(state, "output").get("unit") or "")


def _site_row(name: str, status: DriveStatus) -> tuple[str, ...]:
    state, live = status.state or {}, status.online and status.live
    shown = commands.display_in(state)
    fast = status.telemetry.get("drive", {})
    output, fresh = fast.get("output"), live and commands.number(fast.get("age_s")) <= LIVE_S
    return (
        name,
        _site_state(state, status),
        _shown(output, shown) if fresh and output is not None else "-",
        _setpoint(state, shown) if state else "-",
        str(state.get("controller") or "-"),
        _moment(state.get("since")),
        str(state.get("trip") or ""),
    )


def _site_state(state: dict[str, Any], status: DriveStatus) -> str:
    if not status.online:
        return str(status.availability)
    word = commands.unconfirmed_stop(state)
    text = f"{state.get('state')}, stop {word}" if word else str(state.get("state"))
    return text if status.live else f"{text} (last known)"


def _state(state: dict[str, Any], shown: Display, *, live: bool) -> list[str]:
    since = state.get("since") or state.get("time")
    rows = [
        ("state" if live else "last state", f"{state.get('state')}, since {_moment(since)}"),
        *_stop(state),
        *_trip(state),
        ("controller", _controller(state)),
        ("set-point", _setpoint(state, shown)),
        ("pole", f"{_number(state.get('pole'))} per slow period"),
        ("clock", str(state.get("clock"))),
    ]
    return [_row(name, text) for name, text in rows]


def _stop(state: dict[str, Any]) -> list[tuple[str, str]]:
    """Return that the drive may be energised although it is commanded off."""
    word = commands.unconfirmed_stop(state)
    return [("stop", f"{word}: the drive has not reported its bridge off")] if word else []


def _trip(state: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the latched trip with its remedy, or the last one of this run of the daemon."""
    last = commands.part(state, "last_trip")
    if not last and not state.get("trip"):
        return []
    text = f"{_moment(last.get('time'))}: {last.get('text')}"
    row = ("last trip", with_kind(text, last.get("kind")))
    if state.get("trip"):
        row = ("trip", with_kind(str(state["trip"]), state.get("trip_kind")))
    return [row, *([("remedy", str(last["remedy"]))] if last.get("remedy") else [])]


def _load(load: dict[str, Any], unit: str, shown: Display, given: Given) -> list[str]:
    found = commands.part(load, "estimates")
    units = unit, given.unit
    estimates = (_estimate(name, commands.part(found, name), found, units) for name in found)
    voltages = (
        f"asked {_number(load.get('boost_reference_V'), given.unit)}, "
        f"applied {_number(load.get('applied_V'), given.unit)}"
    )
    return [
        _row("slow step", f"{load.get('k')} at {_moment(load.get('time'))}"),
        _row("reference", _shown(load.get("reference"), shown)),
        _row(given.name, voltages),
        _row("estimates", ", ".join(estimates) or "none"),
    ]


def _drive(drive: dict[str, Any], shown: Display, given: Given) -> list[str]:
    return [
        _row(str(drive.get("output_name") or "output"), _shown(drive.get("output"), shown)),
        _row(f"{given.name} now", _number(drive.get("boost_voltage_V"), given.unit)),
        _row("load power", _number(drive.get("load_power_W"), "W")),
        _row("age", _milliseconds(drive.get("age_s"))),
        _row("ticks", f"{drive.get('ticks')}, missed {drive.get('missed')}"),
    ]


def _controller(state: dict[str, Any]) -> str:
    text = f"{state.get('controller')} (asked for {state.get('mode')})"
    return f"{text}: {state['reason']}" if state.get("reason") else text


def _setpoint(state: dict[str, Any], shown: Display) -> str:
    wave = commands.part(state, "waveform")
    if not wave:
        return _shown(state.get("setpoint"), shown)
    return (
        f"{wave.get('shape')} {_shown(wave.get('low'), replace(shown, unit=''))} to "
        f"{_shown(wave.get('high'), shown)}, "
        f"period {_number(wave.get('period_s'), 's')}"
    )


def _estimate(
    name: str, estimate: dict[str, Any], names: Mapping[str, Any], units: tuple[str, str]
) -> str:
    """Return an estimate with its standard deviation and its unit."""
    quantity, unit = commands.quantity_and_unit(name, names, *units)
    spread = commands.number(estimate.get("std"))
    doubt = "" if math.isnan(spread) else f" ± {spread:.2g}"
    return f"{quantity} {_number(estimate.get('value'))}{doubt} {unit}".rstrip()


def _moment(time: object) -> str:
    """Return a time to the second."""
    return _FRACTION.sub("", str(time)) if time else "-"


def _milliseconds(time_s: object) -> str:
    milliseconds = 1e3 * commands.number(time_s)
    return "unknown" if math.isnan(milliseconds) else f"{milliseconds:.1f} ms"


def _number(value: object, unit: str = "") -> str:
    found = commands.number(value)
    return "unknown" if math.isnan(found) else f"{found:.5g} {unit}".rstrip()


def _shown(value: object, display: Display) -> str:
    """Return a value of the output in the unit in which people see it."""
    return _number(display.shown(commands.number(value)), display.unit)


def _row(name: str, text: str) -> str:
    return f"  {commands.printable(name):<11} {commands.printable(text)}"
