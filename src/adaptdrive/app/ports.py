"""The kind of bus that a configuration names, and the port that it builds."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.bus_kind import BusKind
from adaptdrive.hardware.port import Port


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
    kind = bus_kind(configuration.bus.type, source)
    return kind.build_port(configuration, clock, source, passive=passive)


def bus_kind(bus_type: str, source: Path | str = "configuration") -> BusKind:
    """Import and return one kind of bus; the others stay unloaded.

    Args:
        bus_type: `type` of a `[bus]` or `[[sensor_bus]]`.
        source: The configuration's file, for error messages.

    Raises:
        ConfigurationError: A package that the bus needs is not installed.
    """
    match bus_type:
        case "can":
            from adaptdrive.hardware.dbc.kind import CAN  # noqa: PLC0415 - load what is used

            return CAN
        case "canopen":
            with _canopen_installed(source):
                from adaptdrive.hardware.canopen.kind import CANOPEN  # noqa: PLC0415

            return CANOPEN
        case "scpi":
            from adaptdrive.hardware.scpi.kind import SCPI  # noqa: PLC0415

            return SCPI
        case _:
            from adaptdrive.hardware.modbus.kind import MODBUS  # noqa: PLC0415

            return MODBUS


@contextlib.contextmanager
def _canopen_installed(source: Path | str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as problem:
        if (problem.name or "").partition(".")[0] != "canopen":
            raise
        advice = "'canopen' needs the package canopen: pip install 'adaptdrive[canopen]'"
        raise ConfigurationError(source, [Flaw("bus.type", advice)]) from problem
