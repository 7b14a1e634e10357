"""A drive on Modbus, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.hardware.bus_kind import BusKind
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.modbus.bus import describe_bus
from adaptdrive.hardware.modbus.mapping import map_drive
from adaptdrive.hardware.modbus.port import ModbusPort
from adaptdrive.hardware.modbus.sensors import build_modbus_sensors
from adaptdrive.hardware.port import Port


def _build(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool,  # noqa: ARG001 - reading is all that a master on Modbus does until it commands
) -> Port:
    bus, signals = _bus(configuration), configuration.signals
    half_cycle_s = 0.5 / configuration.drive.line_frequency_Hz
    poll = map_drive(bus, signals, half_cycle_s, source, demands_of(configuration))
    return ModbusPort(bus, poll, bus.poll_ticks * half_cycle_s, clock)


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield the device: Modbus shows no requests of another client."""
    yield describe_bus(_bus(configuration))


def _bus(configuration: Configuration) -> ModbusTcp | ModbusRtu:
    assert isinstance(configuration.bus, ModbusTcp | ModbusRtu)  # noqa: S101 - selected by its type
    return configuration.bus


MODBUS = BusKind(_build, build_modbus_sensors, lock_names=_lock_names)
