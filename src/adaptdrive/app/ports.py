"""The port that a configuration asks for: one factory for each kind of bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.control.signals import Command
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.demands import Demands
from adaptdrive.hardware.port import Port

if TYPE_CHECKING:
    from adaptdrive.hardware.dbc.mapping import Timing


def build_port(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool = False,
) -> Port:
    """Build the port of a drive; nothing is opened yet.

    Args:
        configuration: The drive.
        clock: Monotonic clock in seconds.
        source: The configuration's file, for error messages.
        passive: Whether the drive must only be looked at: nothing is written to it, not even
            what would have to be set up first.

    Raises:
        ConfigurationError: Bus and signals do not fit; every flaw is listed.
    """
    bus, signals = configuration.bus, configuration.signals
    half_cycle_s = 0.5 / configuration.drive.line_frequency_Hz
    demands = demands_of(configuration)
    if isinstance(bus, CanBus):
        from adaptdrive.hardware.dbc.port import build_can_port  # noqa: PLC0415 - what is used

        timing = can_timing(configuration)
        return build_can_port(
            bus, signals, timing, clock, source=source, hears_all=passive, demands=demands
        )
    if isinstance(bus, CanOpenBus):
        with _canopen_installed(source):
            from adaptdrive.hardware.canopen.port import (  # noqa: PLC0415 - load what is used
                build_canopen_port,
            )
            from adaptdrive.hardware.canopen.watch import build_canopen_watch  # noqa: PLC0415

        if passive:
            return build_canopen_watch(bus, signals, clock, source=source)
        return build_canopen_port(bus, signals, half_cycle_s, clock, source=source, demands=demands)
    from adaptdrive.hardware.modbus.port import (  # noqa: PLC0415 - load what is used
        build_modbus_port,
    )

    return build_modbus_port(bus, signals, half_cycle_s, clock, source=source, demands=demands)


def can_timing(configuration: Configuration) -> Timing:
    """Return what decides how old a value of a drive on CAN may be."""
    from adaptdrive.hardware.dbc.mapping import Timing  # noqa: PLC0415 - load what is used

    return Timing(
        half_cycle_s=0.5 / configuration.drive.line_frequency_Hz,
        stale_s=configuration.interlocks.stale_s,
        daemon_holds_voltage=configuration.voltage_loop.where == "daemon",
    )


def demands_of(configuration: Configuration) -> Demands:
    """Return what the limits of a configuration ask of its signals."""
    limits, scale_S = configuration.drive.limits, 0.0
    if configuration.voltage_loop.where == "daemon":
        scale_S = configuration.drive.limits.current_scale_max_S
    lowest_S = -scale_S if configuration.drive.kind == "bidirectional" else 0.0
    return Demands(
        output_unit=configuration.load.output_unit,
        commands=(
            Command(lowest_S, limits.boost_reference_min_V, bridge=True),
            Command(scale_S, limits.boost_reference_max_V, bridge=True),
        ),
    )


@contextlib.contextmanager
def _canopen_installed(source: Path | str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] != "canopen":
            raise
        advice = "'canopen' needs the package canopen: pip install 'adaptdrive[canopen]'"
        raise ConfigurationError(source, [Flaw("bus.type", advice)]) from problem
