"""Simulated sensor modules on a Modbus link: they show what they measure on the drive's plant.

Each device id of the map is a module. Registers that no signal is taken from are its settings: they
can be written and read back. What is measured cannot be written.
"""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable, Mapping

from pymodbus.constants import ExcCodes

from adaptdrive.config.sensors import ModbusRtuSensors, ModbusTcpSensors, SensorRegister
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive.devices.polled.codec import encode_count, encode_value
from adaptdrive_sim.devices.drive import SimulatedDrive
from adaptdrive_sim.devices.modbus_server import serving
from adaptdrive_sim.devices.registers import Table, addresses, bounded, not_available
from adaptdrive_sim.devices.sensor_values import SensorFault, values_of

_LOOK_S = 0.05
"""Interval at which modules check whether they are unplugged."""

Config = ModbusTcpSensors | ModbusRtuSensors


class SensorModule:
    """One simulated module.

    Attributes:
        counts: Requests answered, and settings written and refused, by name.
    """

    def __init__(self, drive: SimulatedDrive, config: Config, device_id: int) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._drive = drive
        self._registers = {
            name: register
            for name, register in config.registers.items()
            if (register.device_id or config.device_id) == device_id
        }
        self._shown = {
            name: source
            for name, source in config.signals.items()
            if source.signal in self._registers
        }
        measured = [self._registers[source.signal] for source in self._shown.values()]
        self._fixed = {
            address
            for register in measured
            if register.table == "holding"
            for address in range(register.address, register.end)
        }
        registers = self._registers.values()
        self._tables: dict[str, Table] = {
            table: addresses(registers, table) for table in ("input", "holding")
        }

    def read(self) -> Mapping[str, Table]:
        """Both tables, with what the plant has now."""
        self.counts["requests"] += 1
        frame, fault = self._drive.frame, self._drive.world.sensor_fault
        if frame is None or fault == SensorFault.OPEN:
            self._show_nothing()
        elif fault != SensorFault.FROZEN:
            self._show(values_of(self._drive.world, frame))
        return self._tables

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Take settings; what is measured is not to be written."""
        wanted = range(address, address + len(words))
        if self._fixed.intersection(wanted):
            self.counts["refused"] += 1
            return ExcCodes.ILLEGAL_ADDRESS
        self._tables["holding"].update(zip(wanted, words, strict=True))
        self.counts["written"] += 1
        return None

    def _show(self, values: Mapping[str, float]) -> None:
        for name, source in self._shown.items():
            register = self._registers[source.signal]
            value = (values[name] - source.offset) / source.scale
            self._place(register, encode_value(register, bounded(register, value)))

    def _show_nothing(self) -> None:
        for source in self._shown.values():
            register = self._registers[source.signal]
            self._place(register, encode_count(register, not_available(register)))

    def _place(self, register: SensorRegister, words: list[int]) -> None:
        span = range(register.address, register.end)
        self._tables[register.table].update(zip(span, words, strict=True))


class ModbusSensors:
    """The modules on one link."""

    def __init__(self, drive: SimulatedDrive, config: Config) -> None:
        ids = {register.device_id or config.device_id for register in config.registers.values()}
        self.modules = {number: SensorModule(drive, config, number) for number in sorted(ids)}
        self._drive = drive
        self._config = config

    @property
    def counts(self) -> dict[str, int]:
        """Requests and settings of all modules, by name."""
        return dict(sum((one.counts for one in self.modules.values()), collections.Counter()))

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the link, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        reported = False
        while True:
            async with serving(self._config, self.modules):
                if not reported:
                    opened(describe_bus(self._config))
                    reported = True
                await self._until(unplugged=True)
            await self._until(unplugged=False)

    async def _until(self, *, unplugged: bool) -> None:
        """Wait until the modules are unplugged, or plugged in again."""
        world = self._drive.world
        while (world.sensor_fault == SensorFault.UNPLUGGED) is not unplugged:  # noqa: ASYNC110 - the plant knows no events
            await asyncio.sleep(_LOOK_S)
