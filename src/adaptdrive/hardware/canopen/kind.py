"""A CiA 402 drive on CANopen, as the daemon builds it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanOpenBus
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, Row, bus_of, stale_limits
from adaptdrive.hardware.canopen.mapping import CanOpenMapping, map_drive
from adaptdrive.hardware.canopen.port import CanOpenPort
from adaptdrive.hardware.canopen.watch import CanOpenWatch
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.port import Port

_LOST_HEARTBEATS = 2
"""Heartbeats in a row that a bus may lose now and then without a fault: one of 50 frames lost."""


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port:
    bus, mapping = bus_of(configuration, CanOpenBus), _mapped(configuration, source)
    if passive:
        return CanOpenWatch(bus, mapping, clock)
    return CanOpenPort(bus, mapping, configuration.timing, clock)


def _mapped(configuration: Configuration, source: Path | str = "configuration") -> CanOpenMapping:
    """Return the objects of a drive, held against what its limits ask."""
    bus, demands = bus_of(configuration, CanOpenBus), demands_of(configuration)
    return map_drive(bus, configuration.signals, source, demands)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    yield from stale_limits(configuration, source)
    timeout_s = bus_of(configuration, CanOpenBus).heartbeat_timeout_s
    yield "silent node", timeout_s, "bus.heartbeat_timeout_s"


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield that a few lost frames may stop the drive, and what is wrong in its EDS."""
    bus = bus_of(configuration, CanOpenBus)
    yield from _mapped(configuration).cautions
    survived = math.ceil(bus.heartbeat_timeout_s / bus.heartbeat_s - 1e-9) - 2
    if survived < _LOST_HEARTBEATS:
        yield Flaw(
            "bus.heartbeat_s",
            f"{bus.heartbeat_s:g} s: of the heartbeats within bus.heartbeat_timeout_s = "
            f"{bus.heartbeat_timeout_s:g} s no more than {survived} in a row may be lost before "
            "the drive stops, or the daemon trips; shorten it, or lengthen that time-out",
        )


CANOPEN = BusKind(_build, _cautions, time_limits=_time_limits)
