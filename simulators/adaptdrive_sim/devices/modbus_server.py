"""Serving simulated devices on Modbus: TCP, or RTU on a serial port, made where there is none."""

from __future__ import annotations

import contextlib
import termios
from collections.abc import AsyncIterator, Mapping
from typing import Protocol

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adaptdrive.config.polled import RtuLink, TcpLink
from adaptdrive.devices.modbus.link import describe_bus
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices.pty_cable import pty_cable
from adaptdrive_sim.devices.registers import Table

_TABLES = {3: "holding", 4: "input", 6: "holding", 16: "holding", 22: "holding", 23: "holding"}


class Registers(Protocol):
    """Replies of a device to requests."""

    def read(self) -> Mapping[str, Table]:
        """Both tables as they are now."""

    def write(self, address: int, words: list[int]) -> ExcCodes | None:
        """Write registers; return the exception code of the reply, None when they are accepted."""


@contextlib.asynccontextmanager
async def serving(link: TcpLink | RtuLink, devices: Mapping[int, Registers]) -> AsyncIterator[None]:
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
    link: TcpLink | RtuLink, devices: list[SimDevice], stack: contextlib.ExitStack
) -> ModbusTcpServer | ModbusSerialServer:
    if isinstance(link, TcpLink):
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
