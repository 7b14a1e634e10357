"""A CiA 402 drive on CANopen, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.hardware.bus_kind import BusKind, Row, stale_limits
from adaptdrive.hardware.canopen.mapping import map_drive
from adaptdrive.hardware.canopen.port import CanOpenPort
from adaptdrive.hardware.canopen.watch import CanOpenWatch
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.port import Port


def _build(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool,
) -> Port:
    bus, signals = _bus(configuration), configuration.signals
    if passive:
        return CanOpenWatch(bus, map_drive(bus, signals, source), clock)
    half_cycle_s = 0.5 / configuration.drive.line_frequency_Hz
    mapping = map_drive(bus, signals, source, demands_of(configuration))
    return CanOpenPort(bus, mapping, half_cycle_s, clock)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    yield from stale_limits(configuration, source)
    yield "silent node", _bus(configuration).heartbeat_timeout_s, "bus.heartbeat_timeout_s"


def _bus(configuration: Configuration) -> CanOpenBus:
    assert isinstance(configuration.bus, CanOpenBus)  # noqa: S101 - selected by its type
    return configuration.bus


CANOPEN = BusKind(_build, time_limits=_time_limits)
