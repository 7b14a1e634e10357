"""`adaptdrive probe`: decoded measurements of the bus, and the frames that cannot be used.

Nothing is commanded, unless asked for: then the safe command alone.
"""

import asyncio
import math
import os
import sys
from dataclasses import asdict
from itertools import count
from pathlib import Path
from typing import TextIO

import msgspec

from adaptdrive.app import examine, ports, process
from adaptdrive.cli.options import Json
from adaptdrive.config import Configuration
from adaptdrive.control.signals import SAFE_COMMAND
from adaptdrive.devices.port import Port
from adaptdrive.runtime.reports import SensorReport
from adaptdrive.safety.facts import Reading
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
    try:
        with process.locked(locks, os.environ):
            port = ports.build_whole_port(configuration, now_s, config, passive=not safe_command)
            asyncio.run(_Probe(configuration, port, as_json=as_json).run(safe_command=safe_command))
    except* (AdaptdriveError, OSError) as group:  # standard output may be one that is full
        raise first_error(group) from None
    return 0


class _Probe:
    """Shows what comes from the bus."""

    def __init__(self, configuration: Configuration, port: Port, *, as_json: bool) -> None:
        self._load, self._given = configuration.load, configuration.drive.given
        self._port = port
        self._as_json = as_json
        self._reading: Reading | None = None

    def on_reading(self, reading: Reading) -> None:
        """Keep the latest reading."""
        self._reading = reading

    def on_bus(self, up: bool, detail: str) -> None:
        """Print that the bus was lost or came back."""
        sys.stderr.write(f"bus {'up' if up else 'lost'}: {detail}\n")

    async def run(self, *, safe_command: bool) -> None:
        """Print what is known every half second until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._port.run(self, lambda: self._remark(self._port.description)))
            if safe_command:
                tasks.create_task(self._command())
            for number in count():
                await asyncio.sleep(_EVERY_S)
                if self._as_json:
                    _print(msgspec.json.encode(self._content(number)).decode())
                else:
                    self._show_text(number)

    def _remark(self, text: str) -> None:
        """Print a remark next to what is shown."""
        _print(text, sys.stderr if self._as_json else sys.stdout)

    def _show_text(self, number: int) -> None:
        _print(self._line())
        for report in ports.sensor_reports(self._port, now_s)():
            _print(_sensor_line(report))
        if number % _DETAILS_EVERY == 1:
            for line in self._port.details():
                _print(f"  {line}")

    def _content(self, number: int) -> dict[str, object]:
        """Return a reading, null before the first; names end in the unit, but for the output."""
        reading, port = self._reading, self._port
        return {
            "number": number,
            "age_s": None if reading is None else now_s() - reading.oldest_s,
            "reading": reading,
            "output": {"name": self._load.output_name, "unit": self._load.output_unit},
            "manipulated": self._given,
            "frames": port.statistics,
            "sensors": ports.sensor_reports(port, now_s)(),
            "refused": list(port.details()),
        }

    def _line(self) -> str:
        counted = asdict(self._port.statistics).items()
        counts = ", ".join(f"{name} {count}" for name, count in counted if count)
        reading, load, given = self._reading, self._load, self._given
        if reading is None:
            return f"no reading yet ({counts or 'no frames'})"
        age_ms = (now_s() - reading.oldest_s) * 1e3
        return (
            f"{given.name} {given.text(reading.boost_voltage_V, '7.2f')}  "
            f"line {_shown(reading.line_voltage_V, '6.1f')} V  "
            f"load {_shown(reading.load_power_W, '7.1f')} W  {load.output_name} "
            f"{load.display.text(reading.output, '9.5f')}  "
            f"bridge {'on' if reading.bridge else 'off'}  "
            f"{_watched(reading)}  age {age_ms:5.1f} ms  ({counts})"
        )

    async def _command(self) -> None:
        """Listen, then send the safe command until cancelled; print how the drive reacts.

        Raises:
            AdaptdriveError: Somebody else commands the drive.
        """
        port = self._port
        await asyncio.sleep(_LISTEN_S)
        if port.statistics.foreign_commands:
            raise AdaptdriveError(f"no command sent: {port.trip_cause}")
        before = _shown_state(self._reading)
        for number in count(1):
            port.send(SAFE_COMMAND)
            await asyncio.sleep(_COMMAND_S)
            if number % _ANSWER_EVERY == 0:
                sent, dropped = port.statistics.sent, port.statistics.send_drops
                self._remark(
                    f"safe command: sent {sent}, dropped {dropped}; the drive says "
                    f"{_shown_state(self._reading)} (before: {before})"
                )


def _print(text: str, stream: TextIO | None = None) -> None:
    print(text, file=stream, flush=True)


def _shown_state(reading: Reading | None) -> str:
    if reading is None:
        return "nothing"
    return f"bridge {'on' if reading.bridge else 'off'}, {_watched(reading)}"


def _watched(reading: Reading) -> str:
    name = f" ({reading.fault_name})" if reading.fault_name else ""
    warning = f", warning {reading.warning}" if reading.warning else ""
    return f"fault {reading.fault:#x}{name}{warning}"


def _sensor_line(report: SensorReport) -> str:
    values = "  ".join(
        f"{name} {value:.6g} (age {report.age_s[name] * 1e3:.0f} ms)"
        for name, value in report.values.items()
    )
    counts = ", ".join(f"{name} {count}" for name, count in report.bus.items() if count)
    lost = "" if report.up else f"lost: {report.detail}  "
    return f"  {report.name}: {lost}{values or 'no value yet'}  ({counts or 'no replies'})"


def _shown(value: float, form: str) -> str:
    """Return a value as text, a dash for one that nobody measures."""
    return "-" if math.isnan(value) else format(value, form)
