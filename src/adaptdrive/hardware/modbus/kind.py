"""A drive on Modbus, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from ipaddress import IPv6Address, ip_address
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import Signals
from adaptdrive.config.modbus import ModbusRtu, ModbusTcp
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, timeout_cautions
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.modbus.link import describe_bus
from adaptdrive.hardware.modbus.mapping import map_drive
from adaptdrive.hardware.modbus.port import ModbusPort
from adaptdrive.hardware.modbus.sensors import build_modbus_sensors
from adaptdrive.hardware.port import Port
from adaptdrive.hosts import look_up

_LOOK_UP_S = 2.0
"""Longest wait for the addresses of a drive's host: its daemon starts without them, too."""


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, *, passive: bool
) -> Port:
    bus, signals = _bus(configuration), configuration.signals
    timing, demands = configuration.timing, demands_of(configuration)
    poll = map_drive(bus, signals, timing.half_cycle_s, source, demands)
    if passive:  # without a command, nothing else is written
        poll = replace(poll, setup=())
    return ModbusPort(bus, poll, timing, clock)


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what the drive's own time-out does not fit, and a report that may be an echo."""
    yield from timeout_cautions(configuration.timing, "bus.poll_ticks")
    yield from _echo_cautions(_bus(configuration), configuration.signals)


def _echo_cautions(bus: ModbusTcp | ModbusRtu, signals: Signals) -> Iterator[Flaw]:
    """Yield one word on a report of the bridge in the register of its command."""
    report, command = signals.bridge, signals.command.bridge
    if report is None or command is None:
        return
    read, written = bus.registers[report.signal], bus.registers[command.signal]
    same = read.table == written.table or (read.table, written.table) == ("discrete", "coil")
    if not same or read.address != written.address:
        return
    yield Flaw(
        "signals.bridge",
        f"{report.signal!r} lies in the register of signals.command.bridge: where the drive only "
        "keeps there what was written, each stop is confirmed, of a drive that does not obey too; "
        "name a register that follows the power stage, or see with the drive in local mode that "
        "the register does not follow the command",
    )


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a device over TCP, by its addresses, too; a serial line is locked as a whole."""
    bus = _bus(configuration)
    if isinstance(bus, ModbusTcp):
        yield describe_bus(bus)
        for address in tcp_addresses(bus.host, bus.port):
            yield f"modbus-tcp address {address} device {bus.device_id}"


def tcp_addresses(host: str, port: int) -> list[str]:
    """Return each address of a host with its port, none where its name server does not answer.

    Args:
        host: Name or address.
        port: TCP port.
    """
    try:
        found = look_up(host, port).result(_LOOK_UP_S)
    except (OSError, ValueError, TimeoutError):
        return []
    return sorted(f"{one} port {port}" for one in {*map(_plain, found)})


def _plain(address: str) -> str:
    """Return the IPv4 address that an IPv6 address stands for, and each other one as it is."""
    found = ip_address(address)
    mapped = found.ipv4_mapped if isinstance(found, IPv6Address) else None
    return str(mapped or found)


def _bus(configuration: Configuration) -> ModbusTcp | ModbusRtu:
    assert isinstance(configuration.bus, ModbusTcp | ModbusRtu)  # noqa: S101 - selected by its type
    return configuration.bus


MODBUS = BusKind(_build, _cautions, build_modbus_sensors, lock_names=_lock_names)
