"""Simulated sensors on buses of their own, which measure on the plant of the simulated drive.

The sensors read the same configuration as the daemon: what is called so there is shown so here. On
Modbus each device id of the map is a module. Registers that no signal is taken from are its
settings: they can be written and read back. What is measured cannot be written.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from pathlib import Path

import can
from pymodbus.constants import ExcCodes

from adaptdrive.config import root
from adaptdrive.devices.can import bus as can_bus
from adaptdrive.devices.can.kind import map_sensors
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive.devices.polled.registers import encode_count, encode_value
from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive_sim.devices import modbus
from adaptdrive_sim.devices.can import send
from adaptdrive_sim.devices.drive import Frame, SimulatedDrive
from adaptdrive_sim.plants import bath, motor
from adaptdrive_sim.world import World


class SensorFault(IntEnum):
    """Fault of the sensors on other buses."""

    NONE = 0
    OPEN = 1
    FROZEN = 2
    UNPLUGGED = 3


def values_of(world: World, frame: Frame) -> dict[str, float]:
    """Every value that a sensor can measure, in SI.

    Args:
        world: The plant.
        frame: What the drive measured last; its noise is that of the sensors too.
    """
    sample = frame.sample
    source_V = world.coupling.ratio * sample.boost_voltage_V
    values = frame.quantities()
    values["load_voltage"] = source_V - world.coupling.droop_Ohm * sample.load_current_A
    values["load_current"] = sample.load_current_A
    load = world.load
    if isinstance(load, bath.Bath):
        values["inflow_temperature"] = load.inflow_K + load.inflow_shift_K
        values["bath_temperature"] = load.inflow_K + sample.output
    elif isinstance(load, motor.Motor):
        values["tachometer_voltage"] = sample.output
    return values


def check_names(buses: Iterable[root.AnySensorBus], world: World, source: Path) -> None:
    """Make sure that the plant has what the sensors are to measure.

    Args:
        buses: Their sections of the configuration.
        world: The plant.
        source: The configuration, for the error message.

    Raises:
        ConfigurationError: It has not; all that is missing is listed.
    """
    known = values_of(world, Frame(world.at_rest(), 0, bridge=False))
    wanted = [(number, name) for number, bus in enumerate(buses) for name in bus.signals]
    lacking = f"the simulated plant has no {{!r}}; it has {', '.join(sorted(known))}"
    flaws = [
        Flaw(f"sensor_bus.{number}.signals.{name}", lacking.format(name))
        for number, name in wanted
        if name not in known
    ]
    if flaws:
        raise ConfigurationError(source, flaws)


# Simulated sensors on a CAN bus: every cycle they send what they measure on the drive's plant.


class CanSensors:
    """The sensors on one bus."""

    def __init__(
        self, drive: SimulatedDrive, config: root.CanSensorSection, place: str, source: Path
    ) -> None:
        """Build the sensors; nothing is opened yet.

        Raises:
            ConfigurationError: The database does not have their signals.
        """
        self._drive = drive
        self._config = config
        self._messages = map_sensors(config, place, source)
        self._frozen: dict[str, float] = {}

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and send until cancelled.

        Raises:
            BusError: The bus cannot be opened.
        """
        with can_bus.open_bus(self._config) as bus:
            opened(can_bus.describe_bus(self._config))
            while True:
                await asyncio.sleep(self._config.cycle_s)
                self._send_all(bus)

    def _send_all(self, bus: can.BusABC) -> None:
        frame, fault = self._drive.frame, self._drive.world.sensor_fault
        if frame is None or fault == SensorFault.UNPLUGGED:
            return
        if fault != SensorFault.FROZEN:
            self._frozen = values_of(self._drive.world, frame)
        for message in self._messages:
            shown: dict[str, float | None] = {
                one.field.name: (self._frozen[one.quantity] - one.offset) / one.scale
                for one in message.sources
            }
            if fault == SensorFault.OPEN:
                shown = dict.fromkeys(shown)
            send(bus, message.codec.frame(message.codec.encode(shown)))


# Simulated sensor modules on a Modbus link.

_LOOK_S = 0.05
"""Interval at which modules check whether they are unplugged."""

Config = root.ModbusTcpSensors | root.ModbusRtuSensors


class SensorModule:
    """One simulated module."""

    def __init__(self, drive: SimulatedDrive, config: Config, device_id: int) -> None:
        self._drive = drive
        registers = {
            name: register
            for name, register in config.registers.items()
            if (register.device_id or config.device_id) == device_id
        }
        self._shown = {
            name: (source, registers[source.signal])
            for name, source in config.signals.items()
            if source.signal in registers
        }
        self._measured = {
            address
            for _, register in self._shown.values()
            if register.table == "holding"
            for address in range(register.address, register.end)
        }
        self._tables = modbus.tables_of(registers.values())

    def read(self) -> Mapping[str, modbus.Table]:
        """Both tables, with what the plant has now."""
        frame, fault = self._drive.frame, self._drive.world.sensor_fault
        if frame is None or fault == SensorFault.OPEN:
            for _, register in self._shown.values():
                self._place(register, encode_count(register, modbus.not_available(register)))
        elif fault != SensorFault.FROZEN:
            self._show(values_of(self._drive.world, frame))
        return self._tables

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Take settings; what is measured is not to be written."""
        wanted = dict(enumerate(words, address))
        if self._measured.intersection(wanted):
            return ExcCodes.ILLEGAL_ADDRESS
        self._tables["holding"].update(wanted)
        return None

    def _show(self, values: Mapping[str, float]) -> None:
        for name, (source, register) in self._shown.items():
            value = modbus.bounded(register, (values[name] - source.offset) / source.scale)
            self._place(register, encode_value(register, value))

    def _place(self, register: root.SensorRegister, words: list[int]) -> None:
        self._tables[register.table].update(enumerate(words, register.address))


class ModbusSensors:
    """The modules on one link."""

    def __init__(self, drive: SimulatedDrive, config: Config) -> None:
        ids = {register.device_id or config.device_id for register in config.registers.values()}
        self.modules = {number: SensorModule(drive, config, number) for number in sorted(ids)}
        self._drive = drive
        self._config = config

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the link, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        reported = False
        while True:
            async with modbus.serving(self._config, self.modules):
                if not reported:
                    opened(describe_bus(self._config))
                    reported = True
                await self._until(unplugged=True)
            await self._until(unplugged=False)

    async def _until(self, *, unplugged: bool) -> None:
        """Wait until the modules are unplugged, or plugged in again."""
        world = self._drive.world
        while (world.sensor_fault == SensorFault.UNPLUGGED) is not unplugged:  # noqa: ASYNC110 - the plant has no events
            await asyncio.sleep(_LOOK_S)
