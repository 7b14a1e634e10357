"""The simulated drive and simulated sensors on Modbus, TCP or RTU.

It shows its registers as they were at the end of the last half cycle. A write to the command is
obeyed when every value is in range and, where the map has one, the daemon's heartbeat has advanced;
otherwise it is answered with an exception, or ignored and counted.

Each device id of the map is a module. Registers that no signal is taken from are its settings: they
can be written and read back. What is measured cannot be written.
"""

import asyncio
import collections
import contextlib
import os
import termios
import time
import tty
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adaptdrive.config import bus, polled, root
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive.devices.polled.registers import encode_count, encode_value
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices import sensor_values
from adaptdrive_sim.devices.drive import Frame, Report, SimulatedDrive, run_half_cycles
from adaptdrive_sim.devices.frames import (
    RegisterImage,
    Table,
    addresses,
    bounded,
    not_available,
    quantities_of,
)

# A serial cable without wires: two pseudo-terminals, each end of which is a serial port.

_CHUNK = 4096


@contextlib.contextmanager
def pty_cable(end: Path) -> Iterator[Path]:
    """Lay a cable while the block runs; the event loop carries the bytes.

    Args:
        end: Where one end is found, as a symbolic link to its pseudo-terminal.

    Yields:
        The other end.
    """
    loop = asyncio.get_running_loop()
    with _pty() as (near, near_name), _pty() as (far, far_name):
        loop.add_reader(near, _carry, near, far)
        loop.add_reader(far, _carry, far, near)
        end.symlink_to(near_name)
        try:
            yield far_name
        finally:
            end.unlink(missing_ok=True)
            loop.remove_reader(near)
            loop.remove_reader(far)


def _carry(source: int, sink: int) -> None:
    """Carry what has come; what the other end does not take in time is lost, as on a wire."""
    with contextlib.suppress(BlockingIOError):
        os.write(sink, os.read(source, _CHUNK))


@contextlib.contextmanager
def _pty() -> Iterator[tuple[int, Path]]:
    """Return a pseudo-terminal in raw mode, which stays open while it is unused."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        os.set_blocking(master, False)
        yield master, Path(os.ttyname(slave))
    finally:
        os.close(slave)
        os.close(master)


# Serving simulated devices on Modbus: TCP, or RTU on a serial port, made where there is none.

_TABLES = {3: "holding", 4: "input", 6: "holding", 16: "holding", 22: "holding", 23: "holding"}


class Registers(Protocol):
    """Replies of a device to requests."""

    def read(self) -> Mapping[str, Table]:
        """Both tables as they are now."""

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Write registers; return the exception code of the reply, None when they are accepted."""


@contextlib.asynccontextmanager
async def serving(
    link: polled.TcpLink | polled.RtuLink, devices: Mapping[int, Registers]
) -> AsyncIterator[None]:
    """Serve devices while the block runs.

    Args:
        link: Where they are reached.
        devices: What answers, by device id.

    Raises:
        BusError: The link cannot be opened.
    """
    sims = [_sim_device(number, registers) for number, registers in devices.items()]
    with contextlib.ExitStack() as stack:
        server = _server(link, sims, stack)
        try:
            await server.serve_forever(background=True)
        except (OSError, RuntimeError, termios.error) as problem:
            raise BusError(describe_bus(link), str(problem)) from problem
        try:
            yield
        finally:
            await server.shutdown()  # type: ignore[no-untyped-call]


def _server(
    link: polled.TcpLink | polled.RtuLink, devices: list[SimDevice], stack: contextlib.ExitStack
) -> ModbusTcpServer | ModbusSerialServer:
    if isinstance(link, polled.TcpLink):
        return ModbusTcpServer(devices, address=(link.host, link.port))
    port = link.device
    if not port.exists():
        port = stack.enter_context(pty_cable(link.device))
    return ModbusSerialServer(
        devices,
        framer=FramerType.RTU,
        port=str(port),
        baudrate=link.baud,
        parity=link.parity[0].upper(),
        stopbits=link.stop_bits,
        ignore_missing_devices=True,
    )


def _sim_device(number: int, registers: Registers) -> SimDevice:
    """Return a device as pymodbus serves it: its registers are fetched at each request."""

    async def access(  # noqa: PLR0913, PLR0917 - the signature is pymodbus's
        function_code: int,
        start_address: int,
        address: int,
        count: int,
        current_registers: list[int],
        set_values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        table = _TABLES.get(function_code)
        content = registers.read().get(table or "")
        if not content:
            return ExcCodes.ILLEGAL_FUNCTION
        if set_values is not None:
            return registers.write(address, [int(value) for value in set_values])
        for wanted in range(address, address + count):
            current_registers[wanted - start_address] = content[wanted]
        return None

    none = [SimData(0, count=16, values=False, datatype=DataType.BITS)]
    tables = registers.read()
    blocks = {name: _block(tables[name]) for name in ("holding", "input")}
    return SimDevice(number, (none, none, blocks["holding"], blocks["input"]), action=access)


def _block(table: Table) -> list[SimData]:
    addresses = table or {0: 0}
    return [SimData(min(addresses), count=len(addresses), datatype=DataType.REGISTERS)]


# The simulated drive as a device on Modbus: a TCP server, or an RTU device on a serial port.


class ModbusDrive:
    """One simulated drive on one link.

    Attributes:
        counts: Requests answered, commands obeyed and refused, by name.
    """

    def __init__(
        self,
        drive: SimulatedDrive,
        config: polled.ModbusTcp | polled.ModbusRtu,
        signals: bus.Signals,
        report: Report,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._drive = drive
        self._config = config
        self._report = report
        self._clock = clock
        self._image = RegisterImage(config, signals)
        self._heartbeat: tuple[int, ...] | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the link, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        async with serving(self._config, {self._config.device_id: self}):
            opened(describe_bus(self._config))
            await run_half_cycles(self._drive, self._clock, self.show, self._report)

    def show(self, frame: Frame) -> None:
        """Put a half cycle into the registers."""
        self._image.show(quantities_of(frame))

    def read(self) -> Mapping[str, Table]:
        """Both tables as they were at the end of the last half cycle."""
        self.counts["requests"] += 1
        return self._image.tables

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Obey a write that is whole, in range and alive."""
        image = self._image
        holding = {**image.tables["holding"]}
        holding |= {address + number: word for number, word in enumerate(words)}
        command = image.command({**image.tables, "holding": holding})
        if command is None:
            self._refuse("out_of_range")
            return ExcCodes.ILLEGAL_VALUE
        image.tables["holding"] = holding
        heartbeat = image.heartbeat(image.tables)
        if heartbeat is not None and heartbeat == self._heartbeat:
            self._refuse("counter_stuck")
            return None
        self._heartbeat = heartbeat
        self.counts["obeyed"] += 1
        self._drive.hold(command.boost_reference_V, command.bridge, self._clock())
        return None

    def _refuse(self, reason: str) -> None:
        """Count a refusal, and report the first of its kind: a flood must not fill the log."""
        self.counts[reason] += 1
        if self.counts[reason] == 1:
            self._report("command refused", reason=reason)


# Simulated sensor modules on a Modbus link: they show what they measure on the drive's plant.

_LOOK_S = 0.05
"""Interval at which modules check whether they are unplugged."""

Config = root.ModbusTcpSensors | root.ModbusRtuSensors


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
        if frame is None or fault == sensor_values.SensorFault.OPEN:
            self._show_nothing()
        elif fault != sensor_values.SensorFault.FROZEN:
            self._show(sensor_values.values_of(self._drive.world, frame))
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

    def _place(self, register: root.SensorRegister, words: list[int]) -> None:
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
        while (world.sensor_fault == sensor_values.SensorFault.UNPLUGGED) is not unplugged:  # noqa: ASYNC110 - the plant knows no events
            await asyncio.sleep(_LOOK_S)
