"""The simulated drive and simulated sensors on Modbus, TCP or RTU.

It shows its registers as they were at the end of the last half cycle. A write to the command is
obeyed when every value is in range and, where the map has one, the daemon's heartbeat has advanced;
otherwise it is answered with an exception, or ignored and counted.

A table has every address from its first register to its last; what lies between and is not mapped
reads as 0.
"""

import asyncio
import contextlib
import math
import os
import termios
import tty
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adaptdrive.config import polled
from adaptdrive.config.bus import COMMANDED
from adaptdrive.config.root import Configuration
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive.devices.polled import mapping
from adaptdrive.devices.polled import registers as codec
from adaptdrive.util.errors import BusError
from adaptdrive.util.quantity import MEASURED
from adaptdrive_sim.devices.drive import QUANTITIES, DriveNode, Frame, SimulatedDrive

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

Table = dict[int, int]
Link = polled.TcpLink | polled.RtuLink


class Registers(Protocol):
    """Replies of a device to requests."""

    def read(self) -> Mapping[str, Table]:
        """Both tables as they are now."""

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Write registers; return the exception code of the reply, None when they are accepted."""


@contextlib.asynccontextmanager
async def serving(link: Link, devices: Mapping[int, Registers]) -> AsyncIterator[None]:
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
    link: Link, devices: list[SimDevice], stack: contextlib.ExitStack
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
        parity=link.parity,
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
    blocks = _block(tables["holding"]), _block(tables["input"])
    return SimDevice(number, (none, none, *blocks), action=access)


def _block(table: Table) -> list[SimData]:
    addresses = table or {0: 0}
    return [SimData(min(addresses), count=len(addresses), datatype=DataType.REGISTERS)]


# The simulated drive as a device on Modbus: a TCP server, or an RTU device on a serial port.

_SHOWN = (*QUANTITIES, mapping.HEARTBEAT)


class ModbusDrive(DriveNode):
    """One simulated drive on one link."""

    def __init__(self, drive: SimulatedDrive, configuration: Configuration, source: Path) -> None:
        """Build the device; nothing is opened yet.

        Raises:
            ConfigurationError: Registers and configuration do not fit together.
        """
        super().__init__(drive)
        assert isinstance(configuration.bus, polled.ModbusTcp | polled.ModbusRtu)  # noqa: S101 - `KINDS` has looked
        self._config = configuration.bus
        self._tables = tables_of(self._config.registers.values())
        poll = mapping.map_drive(configuration, self._config, source, passive=False)
        measured = {one.quantity: one for _, sources in poll.reads for one in sources}
        self._shown = {name: measured[name] for name in _SHOWN if name in measured}
        sinks = (one for _, sinks in poll.writes for one in sinks if one.only is not False)
        self._obeyed = [one for one in sinks if one.name in COMMANDED]
        self._heartbeat: list[int] | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the link, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The link cannot be opened.
        """
        async with serving(self._config, {self._config.device_id: self}):
            opened(describe_bus(self._config))
            await self._run_half_cycles(self.show)

    def show(self, frame: Frame) -> None:
        """Put a half cycle into the registers; bits that share a register are joined."""
        quantities, words = frame.quantities(), dict[tuple[str, int], int]()
        quantities[mapping.HEARTBEAT] = quantities["counter"]
        for name, source in self._shown.items():
            register = source.item.register
            value = (quantities[name] - source.offset) / source.scale
            if name in MEASURED:
                content = codec.encode_value(register, bounded(register, value))
            else:
                content = codec.encode_count(register, _wrapped(register, int(value)))
            for place, word in zip(_places(register), content, strict=True):
                words[place] = word | (0 if register.mask is None else words.get(place, 0))
        for (table, address), word in words.items():
            self._tables[table][address] = word

    def read(self) -> Mapping[str, Table]:
        """Both tables as they were at the end of the last half cycle."""
        self.counts["requests"] += 1
        return self._tables

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Obey a write that is whole, in range and alive."""
        holding = self._tables["holding"] | dict(enumerate(words, address))
        command = self._command({**self._tables, "holding": holding})
        if command is None:
            self._refuse("out_of_range")
            return ExcCodes.ILLEGAL_VALUE
        self._tables["holding"] = holding
        name = self._config.heartbeat.daemon
        heartbeat = None if name is None else _words(self._config.registers[name], self._tables)
        if heartbeat is not None and heartbeat == self._heartbeat:
            self._refuse("counter_stuck")
            return None
        self._heartbeat = heartbeat
        self._obey(command)
        return None

    def _command(self, tables: Mapping[str, Table]) -> dict[str, float] | None:
        """Return the command of the daemon; None when a register has an invalid value."""
        found: dict[str, float] = {}
        for one in self._obeyed:
            register = one.item.register
            value = codec.decode(register, one.field, _words(register, tables))
            if value is None:
                return None
            switches = one.name == "bridge"
            on = one.base + one.factor
            found[one.name] = value == on if switches else (value - one.base) / one.factor
        return found


def tables_of(registers: Iterable[polled.Register]) -> dict[str, Table]:
    """Return input and holding registers from the first to the last, filled with 0."""
    tables: dict[str, Table] = {"input": {}, "holding": {}}
    places = [place for one in registers for place in _places(one)]
    for name in tables:
        used = [address for table, address in places if table == name]
        if used:
            tables[name] = dict.fromkeys(range(min(used), max(used) + 1), 0)
    return tables


def _places(register: polled.Register) -> list[tuple[str, int]]:
    """Table and address of each word of a value."""
    return [(register.table, address) for address in range(register.address, register.end)]


def _words(register: polled.Register, tables: Mapping[str, Table]) -> list[int]:
    return [tables[table][address] for table, address in _places(register)]


def not_available(register: polled.Register) -> float:
    """The count that means `no value`."""
    if register.not_available is not None:
        return register.not_available
    if register.real:
        return math.nan
    span = 1 << 16 * register.words
    return -span // 2 if register.type.startswith("int") else span - 1


def bounded(register: polled.Register, value: float) -> float:
    """Like a converter's, a value ends at the range of its register."""
    field = codec.register_field("", register, "measured")
    # without the count for no value
    ends = field.low + (field.low in field.unknown), field.high - (field.high in field.unknown)
    low, high = sorted(map(field.physical, ends))
    if register.range is not None:
        low, high = max(low, register.range.low), min(high, register.range.high)
    return min(max(value, low), high)


def _wrapped(register: polled.Register, count: int) -> int:
    return count % (1 << (16 * register.words - register.type.startswith("int")))
