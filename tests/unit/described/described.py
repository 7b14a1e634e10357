"""The descriptions of devices, on the wire of a test."""

from __future__ import annotations

import asyncio
import contextlib
import tomllib
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

from adaptdrive.app.ports import build_port, build_sensor_port
from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import Command
from adaptdrive.devices.port import Port
from adaptdrive.safety.facts import Reading
from tests.unit.devices.bench import until

DEVICES = Path(__file__).parents[3] / "deploy" / "devices"
NAMES = sorted(path.stem for path in DEVICES.glob("*.toml"))
_LINE = ("device", "baud", "form")
"""Keys of a serial line; the fakes serve its packets over TCP."""


def described(name: str, **link: Any) -> Configuration:
    """A device's configuration, reached by another link."""
    path = DEVICES / f"{name}.toml"
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    kept = {key: value for key, value in tables["bus"].items() if key not in _LINE}
    tables["bus"] = kept | link
    return validate_configuration(tables, path)


def over_tcp(port: int) -> dict[str, Any]:
    """The link to a fake."""
    return {"type": "modbus-tcp", "framing": "rtu", "host": "127.0.0.1", "port": port}


class Ear:
    """Listens to a port."""

    def __init__(self) -> None:
        self.readings: list[Reading] = []
        self.bus: list[tuple[bool, str]] = []
        self.values: dict[str, float] = {}

    def on_reading(self, reading: Reading) -> None:
        self.readings.append(reading)

    def on_values(self, values: Mapping[str, float], taken_s: float) -> None:
        self.values.update(values)

    def on_bus(self, up: bool, detail: str) -> None:
        self.bus.append((up, detail))


class Bench:
    """A running port of a described device."""

    def __init__(self, port: Port, ear: Ear) -> None:
        self.port = port
        self.ear = ear

    async def reading(self) -> Reading:
        """The next reading."""
        count = len(self.ear.readings)
        await until(lambda: len(self.ear.readings) > count)
        return self.ear.readings[-1]

    async def commands(self, command: Command, done: Any) -> None:
        """Command the device, as the fast loop renews it, until something holds."""

        def renewed() -> bool:
            self.port.send(command)
            return bool(done())

        await until(renewed)


@contextlib.asynccontextmanager
async def running(configuration: Configuration) -> AsyncIterator[Bench]:
    """Run the port of a device."""
    port, ear = build_port(configuration, asyncio.get_running_loop().time, "device.toml"), Ear()
    task = asyncio.create_task(port.run(ear, lambda: None))
    try:
        yield Bench(port, ear)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def sensed(name: str, port: int, wanted: int) -> Ear:
    """What the sensors of a description give."""
    configuration = described(name)
    link = {"host": "127.0.0.1", "port": port, "framing": "tcp", "cycle_s": 0.1}
    bus = configuration.sensor_bus[0].model_copy(update=link)
    ear = Ear()
    sensors = build_sensor_port(bus, "sensor_bus.0", asyncio.get_running_loop().time, "device.toml")
    task = asyncio.create_task(sensors.run(ear))
    await until(lambda: len(ear.values) >= wanted and sensors.statistics.received >= 3)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    return ear
