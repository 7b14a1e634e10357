"""`adaptdrive probe`: what the bus says, decoded; nothing is commanded."""

from __future__ import annotations

import asyncio
import sys
import time
from dataclasses import asdict
from pathlib import Path

from adaptdrive.app.examine import load_examined
from adaptdrive.app.sensors import build_whole_port, sensor_reports
from adaptdrive.config import Configuration
from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.hardware.port import Port, Reading
from adaptdrive.runtime.reports import SensorReport

_EVERY_S = 0.5


class _Probe:
    """Remembers the latest reading."""

    def __init__(self) -> None:
        self.reading: Reading | None = None

    def on_reading(self, reading: Reading) -> None:
        """Keep the reading."""
        self.reading = reading

    def on_bus(self, up: bool, detail: str) -> None:
        """Say that the bus was lost or came back."""
        sys.stderr.write(f"bus {'up' if up else 'lost'}: {detail}\n")


def probe(path: Path) -> int:
    """Print the decoded measurements twice a second until interrupted.

    Args:
        path: Configuration file.

    Raises:
        AdaptdriveError: The configuration or the bus cannot be used.
    """
    configuration = load_examined(path)
    try:
        asyncio.run(_show(configuration, path))
    except* AdaptdriveError as group:
        raise first_error(group) from None
    return 0


async def _show(configuration: Configuration, path: Path) -> None:
    port = build_whole_port(configuration, time.monotonic, path, passive=True)
    listener = _Probe()
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(port.run(listener, lambda: _say(port.description)))
        while True:
            await asyncio.sleep(_EVERY_S)
            _say(_line(configuration, port, listener.reading))
            for report in sensor_reports(port)():
                _say(_sensor_line(report))


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


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
    age_ms = (time.monotonic() - reading.oldest_s) * 1e3
    load = configuration.load
    return (
        f"v_bst {reading.boost_voltage_V:7.2f} V  line {reading.line_voltage_V:6.1f} V  "
        f"load {reading.load_power_W:7.1f} W  {load.output_name} {reading.output:9.5f} "
        f"{load.output_unit}  bridge {'on' if reading.bridge else 'off'}  "
        f"fault {reading.fault:#x}  age {age_ms:5.1f} ms  ({counts})"
    )
