"""Everything that can be known to be wrong with a configuration before a bus is opened."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from pathlib import Path

from adaptdrive.app.plausible import implausible
from adaptdrive.app.ports import build_port, build_sensor_port
from adaptdrive.clock.now import now_s
from adaptdrive.config import Configuration
from adaptdrive.config.file import Findings, find_flaws, read_text
from adaptdrive.config.modbus import ModbusBus, ModbusLink
from adaptdrive.config.scpi import ScpiBus
from adaptdrive.config.sensors import AnySensorBus, sensor_flaws
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.demands import NO_DEMANDS, demands_of

_OF_PORT = frozenset({"drive", "bus", "signals", "voltage_loop", "load", "interlocks"})


def load_examined(path: Path) -> Configuration:
    """Read a configuration and hold it against its DBC, EDS or register map.

    Args:
        path: Configuration file.

    Raises:
        ConfigurationError: There are flaws; those of every kind are listed.
    """
    return examine_text(read_text(path), path)


def examine_text(text: str, path: Path) -> Configuration:
    """Hold the text of a configuration against its DBC, EDS or register map.

    Args:
        text: The text.
        path: The file that it came from.

    Raises:
        ConfigurationError: There are flaws; those of every kind are listed.
    """
    findings = find_flaws(text, path)
    known = {flaw.place for flaw in findings.flaws}
    described = [flaw for flaw in _description_flaws(findings, path) if flaw.place not in known]
    flaws = [*findings.flaws, *described]
    if not findings.flaws:
        flaws += implausible(findings.configuration)
    if flaws:
        raise ConfigurationError(path, flaws)
    return findings.configuration


def _description_flaws(findings: Findings, path: Path) -> Iterator[Flaw]:
    """Yield the errors in the files and maps that describe drive and sensors."""
    configuration = findings.configuration
    if findings.mended >= _OF_PORT and _leads_somewhere(findings):
        yield from _flaws_of(lambda: build_port(configuration, now_s, path))
    if "sensor_bus" not in findings.sound:
        return
    flawed = [flaw.place for flaw in findings.flaws]
    sound = findings.mended >= _OF_PORT
    demands = demands_of(configuration) if sound else NO_DEMANDS
    for number, bus in enumerate(configuration.sensor_bus):
        place = f"sensor_bus.{number}"
        if isinstance(bus, ModbusLink):
            unknown = tuple(_unknown_registers(bus, place))
            yield from unknown
            if unknown or any(one.startswith(f"{place}.") for one in flawed):
                continue
        build = functools.partial(build_sensor_port, bus, place, now_s, path, demands)
        yield from _flaws_of(build)


def _unknown_registers(bus: AnySensorBus, place: str) -> Iterator[Flaw]:
    """Yield the signals of a sensor bus that no register carries: other flaws may hide them.

    The slow period, which such a flaw may concern, does not matter for them.
    """
    flaws = sensor_flaws(bus, place, math.inf)
    return (flaw for flaw in flaws if flaw.place.startswith(f"{place}.signals."))


def _leads_somewhere(findings: Findings) -> bool:
    """Return whether names in `[signals]` can be looked up, which needs a valid register map."""
    if not isinstance(findings.configuration.bus, ModbusBus | ScpiBus):
        return True
    flawed = any(flaw.place.startswith(("bus", "signals")) for flaw in findings.flaws)
    return findings.sound >= _OF_PORT and not flawed


def _flaws_of(build: Callable[[], object]) -> tuple[Flaw, ...]:
    try:
        build()
    except ConfigurationError as error:
        return error.flaws
    return ()
