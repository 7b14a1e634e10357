"""The port of a drive with its separate sensors, as its configuration asks for."""

from collections.abc import Callable
from pathlib import Path

from adaptdrive.config import Configuration
from adaptdrive.config.root import AnySensorBus, in_order, needed_names
from adaptdrive.devices import description
from adaptdrive.devices.bus import BusKind
from adaptdrive.devices.port import Port, SensorPort
from adaptdrive.devices.sensors import SensorBus, SensoredPort
from adaptdrive.runtime.accounts import sensor_report, sensor_sample
from adaptdrive.runtime.reports import SensorReport, SensorSample
from adaptdrive.util.errors import ConfigurationError, Flaw


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
    return kind.build_port(configuration, clock, source, passive)


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
            from adaptdrive.devices.can.kind import CAN  # noqa: PLC0415 - load what is used

            return CAN
        case "canopen":
            try:
                from adaptdrive.devices.canopen.port import CANOPEN  # noqa: PLC0415
            except ModuleNotFoundError as problem:
                if (problem.name or "").partition(".")[0] != "canopen":
                    raise
                advice = "'canopen' needs the package canopen: pip install 'adaptdrive[canopen]'"
                raise ConfigurationError(source, [Flaw("bus.type", advice)]) from problem
            return CANOPEN
        case "scpi":
            from adaptdrive.devices.scpi import SCPI  # noqa: PLC0415

            return SCPI
        case _:
            from adaptdrive.devices.modbus import MODBUS  # noqa: PLC0415

            return MODBUS


def build_whole_port(
    configuration: Configuration,
    clock: Callable[[], float],
    source: Path | str,
    *,
    passive: bool = False,
) -> Port:
    """Build the port of a drive and of its sensor buses; nothing is opened yet.

    Args:
        configuration: The drive.
        clock: Monotonic clock in seconds.
        source: The configuration's file, for error messages.
        passive: Whether the drive must only be looked at.

    Raises:
        ConfigurationError: A bus and its signals do not fit; `examine` lists all flaws.
    """
    port = build_port(configuration, clock, source, passive=passive)
    needed, demands = needed_names(configuration.derived), description.demands_of(configuration)
    buses = []
    for number, bus in enumerate(configuration.sensor_bus):
        sensors = build_sensor_port(bus, f"sensor_bus.{number}", clock, source, demands)
        names = tuple(name for name in bus.signals if name in needed)
        buses.append(SensorBus(bus.name, sensors, bus.oldest_s, names))
    stated = configuration.signals.stated
    if not (buses or configuration.derived or stated):
        return port
    derived = {name: configuration.derived[name] for name in in_order(configuration.derived)}
    return SensoredPort(port, buses, derived, clock, stated)


def build_sensor_port(
    bus: AnySensorBus,
    place: str,
    clock: Callable[[], float],
    source: Path | str,
    demands: description.Demands = description.NO_DEMANDS,
) -> SensorPort:
    """Build the port of one sensor bus; nothing is opened yet.

    Args:
        bus: One entry of `[[sensor_bus]]`.
        place: Where it stands in the configuration.
        clock: Monotonic clock in seconds.
        source: The configuration's file, for error messages.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Bus and signals do not fit; every flaw is listed.
    """
    build = bus_kind(bus.type, source).build_sensors
    assert build is not None  # noqa: S101 - `AnySensorBus` has only kinds that can have sensors
    return build(bus, place, clock, source, demands)


def sensor_reports(
    port: Port, clock: Callable[[], float]
) -> Callable[[], tuple[SensorReport, ...]]:
    """Return a function that reports the sensor buses of a port as they are now.

    Args:
        port: The drive's port, with or without sensors.
        clock: Monotonic clock in seconds.
    """
    if not isinstance(port, SensoredPort):
        return tuple
    return lambda: tuple(sensor_report(bus, clock()) for bus in port.buses)


def publish_samples(
    port: Port, publish: Callable[[SensorSample], None], clock: Callable[[], float]
) -> None:
    """Publish the values of the sensor buses at each fast tick that has a new one.

    Args:
        port: The drive's port, with or without sensors.
        publish: Takes the samples.
        clock: Monotonic clock in seconds.
    """
    if isinstance(port, SensoredPort):
        port.sampled = lambda: publish(sensor_sample(port.buses, clock()))
