"""A drive on CAN, as the daemon builds it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.errors import Flaw
from adaptdrive.hardware.bus_kind import BusKind, Row
from adaptdrive.hardware.dbc.mapping import Timing, map_drive
from adaptdrive.hardware.dbc.port import CanPort
from adaptdrive.hardware.dbc.sensors import build_can_sensors
from adaptdrive.hardware.demands import demands_of
from adaptdrive.hardware.port import Port
from adaptdrive.hardware.relink import silence_limit_s


def _build(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool,
) -> Port:
    bus, demands = _bus(configuration), demands_of(configuration)
    mapping = map_drive(bus, configuration.signals, _timing(configuration), source, demands)
    return CanPort(bus, mapping, clock, hears_all=passive)


def _time_limits(configuration: Configuration, source: Path | str) -> Iterator[Row]:
    """Yield the age of each value, with the slack of a message that comes seldom."""
    stale_s = configuration.interlocks.stale_s
    mapping = map_drive(_bus(configuration), configuration.signals, _timing(configuration), source)
    for one in (one for status in mapping.statuses for one in status.sources):
        keys = f"bus.stale_cycles, {one.cycle_by}" if one.slack_s else "interlocks.stale_s"
        yield f"stale {one.quantity}", stale_s + one.slack_s, keys


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield the message with the bridge, where a drive must wait for it for long."""
    bus, timing = _bus(configuration), _timing(configuration)
    limit_s = silence_limit_s(bus.clock_ticks * timing.half_cycle_s)
    for status in map_drive(bus, configuration.signals, timing).statuses:
        for one in status.sources:
            if one.quantity == "bridge" and one.cycle_s > limit_s:
                yield Flaw("signals.bridge", _seldom(status.codec.name, one.cycle_s, limit_s))


def _seldom(message: str, cycle_s: float, limit_s: float) -> str:
    return (
        f"message {message!r} comes every {cycle_s * 1e3:.4g} ms: after {limit_s * 1e3:.4g} ms "
        "without the daemon or the drive, nothing energises before its next report, and a drive "
        "whose own time-out is shorter stops"
    )


def _bus(configuration: Configuration) -> CanBus:
    assert isinstance(configuration.bus, CanBus)  # noqa: S101 - selected by its type
    return configuration.bus


def _timing(configuration: Configuration) -> Timing:
    return Timing(
        half_cycle_s=0.5 / configuration.drive.line_frequency_Hz,
        stale_s=configuration.interlocks.stale_s,
        daemon_holds_voltage=configuration.voltage_loop.where == "daemon",
    )


CAN = BusKind(_build, build_can_sensors, _time_limits, _cautions)
