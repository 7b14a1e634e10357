"""A supply that speaks SCPI, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.scpi import ScpiBus
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, bus_of, timeout_cautions
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.modbus.kind import tcp_addresses
from adaptdrive.hardware.modbus.mapping import map_drive
from adaptdrive.hardware.port import Port
from adaptdrive.hardware.scpi.link import describe_supply
from adaptdrive.hardware.scpi.port import ScpiPort


def _build(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool,
) -> Port:
    bus, timing = bus_of(configuration, ScpiBus), configuration.timing
    demands, registers = demands_of(configuration), bus.as_registers()
    poll = map_drive(registers, configuration.signals, timing.half_cycle_s, source, demands)
    if passive:  # without a command, nothing else is written
        poll = replace(poll, setup=())
    return ScpiPort(bus, poll, timing, clock)


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what the drive's own time-out does not fit."""
    return timeout_cautions(configuration.timing, "bus.poll_ticks")


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a supply by its name and its addresses."""
    bus = bus_of(configuration, ScpiBus)
    yield describe_supply(bus)
    yield from (f"scpi address {one}" for one in tcp_addresses(bus.host, bus.port))


SCPI = BusKind(_build, _cautions, lock_names=_lock_names)
