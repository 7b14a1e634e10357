"""A CiA 402 drive on CANopen, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.hardware.bus_kind import BusKind, Row, stale_limits
from adaptdrive.hardware.canopen.port import build_canopen_port
from adaptdrive.hardware.canopen.watch import build_canopen_watch
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
        return build_canopen_watch(bus, signals, clock, source=source)
    half_cycle_s = 0.5 / configuration.drive.line_frequency_Hz
    demands = demands_of(configuration)
    return build_canopen_port(bus, signals, half_cycle_s, clock, source=source, demands=demands)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    yield from stale_limits(configuration, source)
    yield "silent node", _bus(configuration).heartbeat_timeout_s, "bus.heartbeat_timeout_s"


def _bus(configuration: Configuration) -> CanOpenBus:
    assert isinstance(configuration.bus, CanOpenBus)  # noqa: S101 - selected by its type
    return configuration.bus


CANOPEN = BusKind(_build, time_limits=_time_limits)
