"""The simulated devices of each kind of bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from adaptdrive.config import Configuration
from adaptdrive.devices.can.kind import map_sensors
from adaptdrive_sim.devices.can import CanDrive, CanSensors
from adaptdrive_sim.devices.canopen import CanOpenDrive
from adaptdrive_sim.devices.drive import Report, SimulatedDrive
from adaptdrive_sim.devices.frames import load_messages
from adaptdrive_sim.devices.modbus import ModbusDrive, ModbusSensors
from adaptdrive_sim.devices.scpi import ScpiDrive


class SensorNode(Protocol):
    """Sensors on a bus."""

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, name it to `opened`, and serve it until cancelled."""


class DriveNode(SensorNode, Protocol):
    """A drive on a bus."""

    counts: Counter[str]


@dataclass(frozen=True, slots=True)
class DeviceKind:
    """The simulated devices of one kind of bus.

    Attributes:
        drive: Puts a drive on the bus of a configuration.
        overrides: Key of `[bus]` that each option of the command line replaces.
        sensors: Puts sensors on a bus, given its section and its place; None for no such kind.
        times_commands: Whether the drive shuts down when commands stop; otherwise a heartbeat.
    """

    drive: Callable[[SimulatedDrive, Configuration, Report, Path], DriveNode]
    overrides: Mapping[str, str]
    sensors: Callable[[SimulatedDrive, Any, str, Path], SensorNode] | None = None
    times_commands: bool = True


def _can_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, source: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return CanDrive(drive, bus, load_messages(bus, configuration, source), report)


def _can_sensors(drive: SimulatedDrive, bus: Any, place: str, source: Path) -> SensorNode:  # noqa: ANN401
    return CanSensors(drive, bus, map_sensors(bus, place, source))


def _modbus_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, _: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return ModbusDrive(drive, bus, configuration.signals, report)


def _scpi_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, _: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return ScpiDrive(drive, bus, configuration.signals, report)


def _modbus_sensors(drive: SimulatedDrive, bus: Any, _: str, __: Path) -> SensorNode:  # noqa: ANN401
    return ModbusSensors(drive, bus)


_CAN_KEYS = {"interface": "interface", "channel": "channel", "port": "udp_port"}

KINDS = {
    "can": DeviceKind(_can_drive, _CAN_KEYS, _can_sensors),
    "canopen": DeviceKind(CanOpenDrive, _CAN_KEYS, times_commands=False),
    "modbus-tcp": DeviceKind(_modbus_drive, {"channel": "host", "port": "port"}, _modbus_sensors),
    "modbus-rtu": DeviceKind(_modbus_drive, {"channel": "device"}, _modbus_sensors),
    "scpi": DeviceKind(_scpi_drive, {"channel": "host", "port": "port"}),
}
