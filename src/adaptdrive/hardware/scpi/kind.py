"""A supply that speaks SCPI, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.scpi import ScpiBus
from adaptdrive.hardware.bus_kind import BusKind, bus_of
from adaptdrive.hardware.polled.kind import planned, polled_cautions, tcp_locks
from adaptdrive.hardware.port import Port
from adaptdrive.hardware.scpi.link import describe_supply
from adaptdrive.hardware.scpi.port import ScpiPort


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, *, passive: bool
) -> Port:
    bus = bus_of(configuration, ScpiBus)
    poll = planned(configuration, bus.as_registers(), source, passive=passive)
    return ScpiPort(bus, poll, configuration.timing, clock)


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a supply by its name and its addresses."""
    bus = bus_of(configuration, ScpiBus)
    yield describe_supply(bus)
    yield from tcp_locks("scpi", bus.host, bus.port)


SCPI = BusKind(_build, polled_cautions, lock_names=_lock_names)
