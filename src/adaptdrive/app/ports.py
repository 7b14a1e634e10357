"""The port that a configuration asks for: one factory for each kind of bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.hardware.port import Port


def build_port(
    configuration: Configuration, clock: Callable[[], float], source: Path | str
) -> Port:
    """Build the port of a drive; nothing is opened yet.

    Args:
        configuration: The drive.
        clock: Monotonic clock in seconds.
        source: The configuration's file, for error messages.

    Raises:
        ConfigurationError: Bus and signals do not fit; every flaw is listed.
    """
    bus, signals = configuration.bus, configuration.signals
    if isinstance(bus, CanBus):
        from adaptdrive.hardware.can.port import (  # noqa: PLC0415 - load what is used
            build_can_port,
        )

        return build_can_port(bus, signals, clock, source=source)
    from adaptdrive.hardware.modbus.port import (  # noqa: PLC0415 - load what is used
        build_modbus_port,
    )

    half_cycle_s = 0.5 / configuration.drive.line_frequency_Hz
    return build_modbus_port(bus, signals, half_cycle_s, clock, source=source)
