"""A simulated device as a process: its settings, its plant, its bus."""

import asyncio
import math
import signal
import sys
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from adaptdrive.app.settings import controller_settings
from adaptdrive.cli.options import Integer, read_address
from adaptdrive.config import file, root
from adaptdrive.mqtt.connection import Broker
from adaptdrive.util.errors import AdaptdriveError, RefusedError, first_error
from adaptdrive.util.lines import configured, write_line
from adaptdrive_sim.devices import can, canopen, disturbances, modbus, scpi
from adaptdrive_sim.devices import drive as drives
from adaptdrive_sim.devices.sensors import CanSensors, ModbusSensors, check_names
from adaptdrive_sim.parameters import check_range
from adaptdrive_sim.plants.boost import BoostParameters, HeldOutput, LineParameters
from adaptdrive_sim.world import NoiseParameters, World, coupling_of, load_of

# Command-line settings of a simulated drive.


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """Settings that `adaptdrive-sim device` adds to the configuration.

    Attributes:
        broker: HOST:PORT of an MQTT broker for disturbances; none when left out.
        noise_V: Standard deviation of each sample of the output, in the unit of the output.
        seed: Seed of the noise.
        initial_voltage_V: Start at rest at this boost voltage instead of at standstill.
        command_timeout_s: Age of the last command, in seconds, at which it shuts down;
            `bus.command_timeout_s` when left out, or 0.1.
        boost_needs_bridge: The boost stage works only while the bridge's enable bit is on.
        line_drift_Hz: Amplitude of the line's frequency drift, in hertz.
        interface: Bus interface instead of the configured one.
        channel: Channel instead of the configured one.
        port: UDP port instead of the configured one.
    """

    broker: str | None = None
    noise_V: Annotated[float, Parameter(name="--noise")] = 0.0
    seed: Integer = 0
    initial_voltage_V: Annotated[float | None, Parameter(name="--initial-voltage")] = None
    command_timeout_s: Annotated[float | None, Parameter(name="--command-timeout")] = None
    boost_needs_bridge: bool = False
    line_drift_Hz: Annotated[float, Parameter(name="--line-drift")] = 0.1
    interface: Literal["socketcan", "udp_multicast"] | None = None
    channel: str | None = None
    port: Integer | None = None


def parse_address(text: str) -> Broker:
    """Read `HOST:PORT`, where an IPv6 address stands in brackets; the port may be left out.

    Raises:
        RefusedError: It is no such thing.
    """
    try:
        host, port = read_address(text)
    except ValueError as problem:
        raise RefusedError(f"broker {text!r} is not HOST:PORT") from problem
    return Broker(host, port)


# The simulated drive as a process: building it, its lines, and its orderly end.

PATIENCE_READINGS = 4
"""Polls without a command before a drive that is polled shuts down, unless its file states less."""

OVERVOLTAGE_SHARE = 2.0 / 3.0
"""Distance from the daemon's trip to the drive's, over that from V_c: 400, 430 and 450 V."""

Job = Callable[[], Coroutine[Any, Any, None]]


_CAN_KEYS = {"interface": "interface", "channel": "channel", "port": "udp_port"}
_TCP_KEYS = {"channel": "host", "port": "port"}

Build = Callable[[drives.SimulatedDrive, root.Configuration, Path], drives.DriveNode]

KINDS: dict[str, tuple[Build, dict[str, str]]] = {
    "can": (can.CanDrive, _CAN_KEYS),
    "canopen": (canopen.CanOpenDrive, _CAN_KEYS),
    "modbus-tcp": (modbus.ModbusDrive, _TCP_KEYS),
    "modbus-rtu": (modbus.ModbusDrive, {"channel": "device"}),
    "scpi": (scpi.ScpiDrive, _TCP_KEYS),
}
"""What puts a drive on each kind of bus, and the key of `[bus]` that an option replaces."""


def run_device(path: Path, settings: DeviceSettings) -> None:
    """Run the simulated drive until SIGTERM or SIGINT.

    Raises:
        AdaptdriveError: It cannot start, or its bus is lost.
    """
    configuration = _overridden(file.load_configuration(path), settings)
    drive = build_drive(configuration, settings, report)
    node = KINDS[configuration.bus.type][0](drive, configuration, path)
    modules = build_sensors(configuration, drive, path)
    jobs: list[Job] = [partial(node.run, partial(_say_bus, "drive", configuration.drive.name))]
    for bus, one in zip(configuration.sensor_bus, modules, strict=True):
        jobs.append(partial(one.run, partial(_say_bus, "sensors", bus.name)))
    if settings.broker is not None:
        address = parse_address(settings.broker)
        jobs.append(disturbances.Remote(address, configuration.drive.name, drive).run)
    try:
        configured()  # what the first line imports takes longer than a half cycle
        asyncio.run(_until_signal(jobs))
    except ExceptionGroup as problems:
        ours, _ = problems.split(AdaptdriveError)
        raise first_error(ours or problems) from problems
    finally:
        report("stopped", ticks=drive.world.tick, **node.counts)


def build_drive(
    configuration: root.Configuration, settings: DeviceSettings, report: drives.Report
) -> drives.SimulatedDrive:
    """Build the drive and its plant.

    Raises:
        ParameterError: A parameter lies outside its range.
        RefusedError: A setting cannot be read.
    """
    world, power = build_world(configuration, settings), configuration.drive
    holder: drives.VoltageHolder | HeldOutput | None = None
    if isinstance(world.boost, HeldOutput):
        holder = world.boost
    elif configuration.voltage_loop.where == "drive":
        bidirectional = power.kind == "bidirectional"
        holder = drives.VoltageHolder(power.boost_capacitance_F, bidirectional=bidirectional)
    over_V = configuration.interlocks.boost_voltage_max_V
    normal_V = power.limits.boost_reference_max_V
    return drives.SimulatedDrive(
        world,
        report,
        holder,
        _command_timeout_s(configuration, settings),
        boost_needs_bridge=settings.boost_needs_bridge,
        trip_V=over_V + OVERVOLTAGE_SHARE * (over_V - normal_V),
        over_V=over_V,
        normal_V=normal_V,
    )


def _command_timeout_s(configuration: root.Configuration, settings: DeviceSettings) -> float:
    """Return the age of the last command at which the drive shuts down.

    Raises:
        ParameterError: It lies outside its range.
        RefusedError: The drive watches a heartbeat instead.
    """
    wanted_s = settings.command_timeout_s
    if configuration.bus.type == "canopen":
        if wanted_s is not None:
            raise RefusedError(f"--command-timeout {wanted_s:g}: canopen watches a heartbeat")
        return math.inf
    stated_s = configuration.bus.command_timeout_s
    if wanted_s is None and stated_s is not None:
        return stated_s
    timeout_s = drives.COMMAND_TIMEOUT_s if wanted_s is None else wanted_s
    check_range("command time-out", timeout_s, 0.01, 60.0, "s")
    if configuration.voltage_loop.where == "daemon":
        return timeout_s
    reading_s = 0.5 * configuration.bus.ticks_per_reading / configuration.drive.line_frequency_Hz
    return max(timeout_s, PATIENCE_READINGS * reading_s)


def build_sensors(
    configuration: root.Configuration, drive: drives.SimulatedDrive, path: Path
) -> list[CanSensors | ModbusSensors]:
    """Put sensors on the buses that its configuration names.

    Raises:
        ConfigurationError: They are to measure what the plant does not have.
    """
    buses = configuration.sensor_bus
    check_names(buses, drive.world, path)
    drive.has_sensors = bool(buses)
    return [
        CanSensors(drive, bus, f"sensor_bus.{number}", path)
        if isinstance(bus, root.CanSensorSection)
        else ModbusSensors(drive, bus)
        for number, bus in enumerate(buses)
    ]


def build_world(configuration: root.Configuration, settings: DeviceSettings) -> World:
    """Build the plant that a configuration and a command line describe.

    Raises:
        ParameterError: A parameter lies outside its range.
        RefusedError: A setting cannot be read.
    """
    drive = configuration.drive
    bidirectional = drive.kind == "bidirectional"
    boost = BoostParameters(drive.boost_capacitance_F, bidirectional=bidirectional)
    world = World(
        load_of(configuration),
        line=LineParameters(drive.line_frequency_Hz, settings.line_drift_Hz, drive.line_voltage_V),
        boost=boost,
        coupling=coupling_of(configuration),
        noise=NoiseParameters(settings.noise_V),
        seed=settings.seed,
    )
    if _holds_output(configuration):
        lag_s = controller_settings(configuration).rates.lag_ticks * drive.half_cycle_s
        world.boost = HeldOutput(boost, lag_s)
    if settings.initial_voltage_V is not None:
        world.settle(settings.initial_voltage_V)
    return world


def _holds_output(configuration: root.Configuration) -> bool:
    """Return whether the drive is no boost stage: it gives less than the peak of its line."""
    drive = configuration.drive
    peak_V = 2.0**0.5 * drive.line_voltage_V
    lowest_V = drive.limits.boost_reference_min_V
    return configuration.voltage_loop.where == "drive" and lowest_V <= peak_V


def report(event: str, **data: object) -> None:
    """Write a line."""
    write_line("info", event, **data, monotonic_s=round(time.monotonic(), 6))


def _overridden(configuration: root.Configuration, settings: DeviceSettings) -> root.Configuration:
    """Let the command line choose another bus."""
    if settings.port is not None:
        check_range("--port", settings.port, 1, 65535, "")
    names = KINDS[configuration.bus.type][1]
    device = None if settings.channel is None else Path(settings.channel)
    given = {
        "interface": settings.interface,
        "channel": device if "device" in names.values() else settings.channel,
        "port": settings.port,
    }
    changes = {names.get(name, ""): value for name, value in given.items() if value is not None}
    if "" in changes:
        raise RefusedError(f"--interface and --port do not all fit {configuration.bus.type}")
    bus = configuration.bus.model_copy(update=changes)
    return configuration.model_copy(update={"bus": bus})


def _say_bus(what: str, name: str, bus: str) -> None:
    sys.stdout.write(f"simulated {what} {name} on {bus}\n")
    sys.stdout.flush()


_CANCEL_AGAIN_S = 1.0


async def _until_signal(jobs: list[Job]) -> None:
    """Run all jobs until one fails or the process is asked to end."""
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, asked.set)
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(job()) for job in jobs]
        await asked.wait()
        # More than once: a client that fails while it is being cancelled loses the cancellation.
        while pending := [task for task in running if not task.done()]:
            for task in pending:
                task.cancel()
            await asyncio.wait(pending, timeout=_CANCEL_AGAIN_S)
