"""A drive on CAN, as the daemon builds it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.config.timing import Timing
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, Row, bus_of, timeout_cautions
from adaptdrive.hardware.dbc.mapping import CanMapping, CanSource, map_drive
from adaptdrive.hardware.dbc.port import CanPort
from adaptdrive.hardware.dbc.sensors import build_can_sensors
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.port import Port


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port:
    return CanPort(
        bus_of(configuration, CanBus), _mapped(configuration, source), clock, hears_all=passive
    )


def _mapped(configuration: Configuration, source: Path | str = "configuration") -> CanMapping:
    """Return the messages of a drive, held against what its limits ask."""
    timing, demands = configuration.timing, demands_of(configuration)
    return map_drive(bus_of(configuration, CanBus), configuration.signals, timing, source, demands)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    """Yield the age of each value, with the slack of a message that comes seldom."""
    stale_s = configuration.interlocks.stale_s
    statuses = _mapped(configuration, source).statuses
    for one in (one for status in statuses for one in status.sources):
        keys = f"bus.stale_cycles, {one.cycle_by}" if one.slack_s else "interlocks.stale_s"
        yield f"stale {one.quantity}", stale_s + one.slack_s, keys


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what the drive's own time-out does not fit, and what may hide the bridge."""
    timing, mapping = configuration.timing, _mapped(configuration)
    sources = [(status.codec.name, one) for status in mapping.statuses for one in status.sources]
    slack_s = min(one.slack_s for _, one in sources)
    yield from timeout_cautions(timing, "bus.clock_ticks", slack_s)
    for message, one in sources:
        if one.quantity == "bridge":
            yield from _bridge_cautions(timing, message, one)
    yield from mapping.cautions


def _bridge_cautions(timing: Timing, message: str, bridge: CanSource) -> Iterator[Flaw]:
    """Yield that a drive must wait, or may have to, for a report of its bridge for long."""
    timeout_s, limit_s = timing.command_timeout_s, timing.silent_s
    every_s, says = bridge.cycle_s, f"comes every {bridge.cycle_s * 1e3:.4g} ms"
    if math.isinf(every_s):  # it may come as seldom as it may be old
        if timeout_s is not None:
            return
        every_s, says = timing.stale_s + bridge.slack_s, "has no GenMsgCycleTime"
    if every_s > limit_s and (timeout_s or 0.0) <= limit_s + every_s:
        yield Flaw(
            "signals.bridge",
            f"message {message!r} {says}: after {limit_s * 1e3:.4g} ms without the daemon or the "
            "drive, or a leap of an alive counter, nothing energises before its next report, and "
            "a drive stops meanwhile whose own time-out (bus.command_timeout_s) is not longer "
            f"than {(limit_s + every_s) * 1e3:.4g} ms",
        )


CAN = BusKind(_build, _cautions, build_can_sensors, _time_limits)
