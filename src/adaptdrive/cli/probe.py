"""`adaptdrive probe`: decoded measurements of the bus, and the frames that cannot be used.

Nothing is commanded, unless asked for: then the safe command alone.
"""

import asyncio
import math
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from itertools import count
from pathlib import Path

import msgspec

from adaptdrive.app import examine, ports, process
from adaptdrive.cli.options import Json
from adaptdrive.config import Configuration
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.port import Port, Reading
from adaptdrive.runtime.reports import SensorReport
from adaptdrive.util.clock import now_s
from adaptdrive.util.errors import AdaptdriveError, first_error

_EVERY_S = 0.5

_DETAILS_EVERY = 6
"""Lines from one list of refused frames to the next: such a list can be long."""

_LISTEN_S = 1.0
"""Time to detect another sender of commands, which sends many frames a second."""

_COMMAND_S = 0.02
"""From one safe command to the next: shorter than any drive's own time-out."""

_ANSWER_EVERY = 50


Remark = Callable[[str], None]
"""Prints a remark next to what is shown."""


Show = Callable[[Configuration, Port, Reading | None, int], None]
"""Prints what is known after so many half seconds."""


class _Probe:
    """Remembers the latest reading."""

    def __init__(self) -> None:
        self.reading: Reading | None = None

    def on_reading(self, reading: Reading) -> None:
        """Keep the reading."""
        self.reading = reading

    def on_bus(self, up: bool, detail: str) -> None:
        """Print that the bus was lost or came back."""
        sys.stderr.write(f"bus {'up' if up else 'lost'}: {detail}\n")


def probe(config: Path, /, *, safe_command: bool = False, as_json: Json = False) -> int:
    """Show decoded measurements and refused frames as they come from the bus; command nothing.

    Args:
        config: Configuration file.
        safe_command: Send the safe command, k = 0 and bridge off, and show the status of the drive.
        as_json: Print one JSON object a line, for programs.

    Returns:
        Exit status.

    Raises:
        AdaptdriveError: The configuration or the bus cannot be used, or another sender commands the
            drive that the safe command is for.
        OSError: Standard output cannot be written.
    """
    configuration = examine.load_examined(config)
    locks = process.lock_names(configuration) if safe_command else ()
    show = _show_json if as_json else _show_text
    remark = _print_aside if as_json else _print
    try:
        with process.locked(locks, os.environ):
            asyncio.run(_listen(configuration, config, (show, remark), safe_command=safe_command))
    except* (AdaptdriveError, OSError) as group:  # standard output may be one that is full
        raise first_error(group) from None
    return 0


async def _listen(
    configuration: Configuration, path: Path, outputs: tuple[Show, Remark], *, safe_command: bool
) -> None:
    show, remark = outputs
    port = ports.build_whole_port(configuration, now_s, path, passive=not safe_command)
    listener = _Probe()
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(port.run(listener, lambda: remark(port.description)))
        if safe_command:
            tasks.create_task(_command(port, listener, remark))
        for number in count():
            await asyncio.sleep(_EVERY_S)
            show(configuration, port, listener.reading, number)


def _show_text(
    configuration: Configuration, port: Port, reading: Reading | None, number: int
) -> None:
    _print(_line(configuration, port, reading))
    for report in ports.sensor_reports(port, now_s)():
        _print(_sensor_line(report))
    if number % _DETAILS_EVERY == 1:
        _print("".join(f"  {line}\n" for line in port.details()), end="")


def _show_json(
    configuration: Configuration, port: Port, reading: Reading | None, number: int
) -> None:
    """Print a reading, null before the first; names end in the unit, the output has its own."""
    age_s = None if reading is None else now_s() - reading.oldest_s
    shown = {
        "number": number,
        "age_s": age_s,
        "reading": reading,
        "output": {"name": configuration.load.output_name, "unit": configuration.load.output_unit},
        "manipulated": configuration.drive.given,
        "frames": port.statistics,
        "sensors": ports.sensor_reports(port, now_s)(),
        "refused": list(port.details()),
    }
    _print(msgspec.json.encode(shown).decode())


async def _command(port: Port, listener: _Probe, remark: Remark) -> None:
    """Listen, then send the safe command until cancelled; print how the drive reacts.

    Raises:
        AdaptdriveError: Somebody else commands the drive.
    """
    await asyncio.sleep(_LISTEN_S)
    if port.statistics.foreign_commands:
        raise AdaptdriveError(f"no command sent: {port.trip_cause}")
    before = _shown_state(listener.reading)
    for number in count(1):
        port.send(SAFE_COMMAND)
        await asyncio.sleep(_COMMAND_S)
        if number % _ANSWER_EVERY == 0:
            counts = port.statistics
            remark(
                f"safe command: sent {counts.sent}, dropped {counts.send_drops}; the drive says "
                f"{_shown_state(listener.reading)} (before: {before})"
            )


def _shown_state(reading: Reading | None) -> str:
    if reading is None:
        return "nothing"
    return f"bridge {'on' if reading.bridge else 'off'}, {_watched(reading)}"


def _watched(reading: Reading) -> str:
    name = f" ({reading.fault_name})" if reading.fault_name else ""
    warning = f", warning {reading.warning}" if reading.warning else ""
    return f"fault {reading.fault:#x}{name}{warning}"


def _print(text: str, end: str = "\n") -> None:
    sys.stdout.write(text + end)
    sys.stdout.flush()


def _print_aside(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def _sensor_line(report: SensorReport) -> str:
    values = "  ".join(
        f"{name} {value:.6g} (age {report.age_s[name] * 1e3:.0f} ms)"
        for name, value in report.values.items()
    )
    counts = ", ".join(f"{name} {count}" for name, count in report.bus.items() if count)
    lost = "" if report.up else f"lost: {report.detail}  "
    return f"  {report.name}: {lost}{values or 'no value yet'}  ({counts or 'no replies'})"


def _line(configuration: Configuration, port: Port, reading: Reading | None) -> str:
    counts = ", ".join(
        f"{name} {count}" for name, count in asdict(port.statistics).items() if count
    )
    if reading is None:
        return f"no reading yet ({counts or 'no frames'})"
    age_ms = (now_s() - reading.oldest_s) * 1e3
    load, given = configuration.load, configuration.drive.given
    return (
        f"{given.name} {given.text(reading.boost_voltage_V, '7.2f')}  "
        f"line {_shown(reading.line_voltage_V, '6.1f')} V  "
        f"load {_shown(reading.load_power_W, '7.1f')} W  {load.output_name} {reading.output:9.5f} "
        f"{load.output_unit}  bridge {'on' if reading.bridge else 'off'}  "
        f"{_watched(reading)}  age {age_ms:5.1f} ms  ({counts})"
    )


def _shown(value: float, form: str) -> str:
    """Return a value as text, a dash for one that nobody measures."""
    return "-" if math.isnan(value) else format(value, form)
