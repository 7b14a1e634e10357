"""The parts by which one kind of bus takes its place in the daemon."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from adaptdrive.config import Configuration
from adaptdrive.config.bus import MEASURED
from adaptdrive.errors import Flaw
from adaptdrive.hardware.demands import Demands
from adaptdrive.hardware.port import Port, SensorPort

Row = tuple[str, float, str]
"""Name of a limit, its duration in seconds, and the keys that set it."""


class BuildPort(Protocol):
    """Builds the port of a drive; nothing is opened yet."""

    def __call__(
        self,
        configuration: Configuration,
        clock: Callable[[], float],
        source: Path | str,
        *,
        passive: bool,
    ) -> Port:
        """Build the port.

        Args:
            configuration: The drive.
            clock: Monotonic clock in seconds.
            source: The configuration's file, for error messages.
            passive: Whether the port must write nothing to the drive.

        Raises:
            ConfigurationError: Bus and signals do not fit; every flaw is listed.
        """


BuildSensors = Callable[[Any, str, Callable[[], float], Path | str, Demands], SensorPort]
"""Builds the port of an entry of `[[sensor_bus]]` from it, its place, clock, source and demands."""


def stale_limits(configuration: Configuration, _: Path | str) -> Iterator[Row]:
    """Yield the age limit of each measured value, which `interlocks.stale_s` sets.

    Args:
        configuration: The drive.
    """
    signals = configuration.signals
    given = [name for name in MEASURED if getattr(signals, name) is not None]
    for name in (*given, *signals.other):
        yield f"stale {name}", configuration.interlocks.stale_s, "interlocks.stale_s"


def no_locks(_: Configuration) -> Iterator[str]:
    """Yield nothing: frames of another sender are received on this kind of bus."""
    return iter(())


def no_cautions(_: Configuration) -> Iterator[Flaw]:
    """Yield nothing: each reading has a report of the bridge, and heartbeats feed the drive."""
    return iter(())


@dataclass(frozen=True, slots=True)
class BusKind:
    """One kind of bus.

    Attributes:
        build_port: Builds the port of a drive.
        build_sensors: Builds the port of a sensor bus, None where there are none of this kind.
        time_limits: Yields the limits of time of a drive.
        cautions: Yields what can be used, and probably does not work well.
        lock_names: Yields what one daemon alone may have, in addition to the drive's name.
    """

    build_port: BuildPort
    build_sensors: BuildSensors | None = None
    time_limits: Callable[[Configuration, Path | str], Iterator[Row]] = stale_limits
    cautions: Callable[[Configuration], Iterator[Flaw]] = no_cautions
    lock_names: Callable[[Configuration], Iterator[str]] = no_locks
