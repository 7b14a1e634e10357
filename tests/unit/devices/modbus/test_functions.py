"""Coils, single writes and other framings, against the server of pymodbus."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator

import pytest
from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from adaptdrive.config.polled import ModbusTcp
from adaptdrive.control.signals import Command
from adaptdrive.devices.modbus.frames import function_of
from adaptdrive.devices.modbus.link import ModbusConnection
from adaptdrive.devices.polled.mapping import Poll, block_words, map_drive, value_in
from adaptdrive.devices.polled.registers import Exchange, exchange_bytes
from adaptdrive.util.errors import ConfigurationError
from tests.unit.config.modbus_documents import parse

COILS: dict[str, str | None] = {
    "bus__registers__state": "{ address = 3, table = 'discrete' }",
    "bus__registers__control": "{ address = 7, table = 'coil' }",
    "bus__registers__wanted": "{ address = 40, table = 'holding', scale = 0.01 }",
    "bus__write": '"single"',
    "signals__bridge": '"state"',
}


class Device:
    """Every table is a list; what is written by which function is kept."""

    def __init__(self) -> None:
        self.bits = [number == 3 for number in range(64)]
        self.coils = [False] * 64
        self.written: list[tuple[int, int, list[int]]] = []

    async def access(  # noqa: PLR0917 - the signature is pymodbus's
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        if values is not None:
            if function == 16:
                return ExcCodes.ILLEGAL_FUNCTION
            self.written.append((function, address, [int(value) for value in values]))
        return None


@contextlib.asynccontextmanager
async def serving(
    port: int, device_id: int = 1, framer: FramerType = FramerType.SOCKET
) -> AsyncIterator[Device]:
    device = Device()
    coils = [SimData(0, values=device.coils, datatype=DataType.BITS)]
    bits = [SimData(0, values=device.bits, datatype=DataType.BITS)]
    registers = [SimData(0, count=64, datatype=DataType.REGISTERS)]
    sim = SimDevice(device_id, (coils, bits, registers, registers), action=device.access)
    server = ModbusTcpServer([sim], framer=framer, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    try:
        yield device
    finally:
        await server.shutdown()  # type: ignore[no-untyped-call]


def plan(**changes: str | None) -> tuple[ModbusTcp, Poll]:
    configuration = parse(**{**COILS, **changes})
    bus = configuration.bus
    assert isinstance(bus, ModbusTcp)
    return bus, map_drive(configuration, bus, "bench.toml", passive=False)


async def polled(bus: ModbusTcp, poll: Poll) -> dict[str, float | None]:
    """What one poll reads; then it writes a command."""
    found: dict[str, float | None] = {}
    link = ModbusConnection(bus, Counter(), asyncio.get_running_loop().time)
    await link.open()
    try:
        for block, sources in poll.reads:
            words = await link.exchange(Exchange(read=block), [])
            found |= {one.quantity: value_in(one, block, words) for one in sources}
        for block, sinks in poll.writes:
            words = block_words(block, sinks, Command(0.0, 2.5, bridge=True), 0)
            await link.exchange(Exchange(write=block), words)
    finally:
        link.close()
    return found


async def test_coils_are_switched_and_registers_written_alone(free_tcp_port: int) -> None:
    bus, poll = plan(bus__port=str(free_tcp_port))
    async with serving(free_tcp_port) as device:
        found = await polled(bus, poll)
    assert found["bridge"] == 1.0
    assert device.written == [(5, 7, [1]), (6, 40, [250])]


@pytest.mark.parametrize("device_id", [0, 255])
async def test_a_device_may_have_any_id_on_tcp(free_tcp_port: int, device_id: int) -> None:
    bus, poll = plan(bus__port=str(free_tcp_port), bus__device_id=str(device_id))
    async with serving(free_tcp_port, device_id) as device:
        assert (await polled(bus, poll))["bridge"] == 1.0
    assert len(device.written) == 2


async def test_packets_of_a_serial_line_pass_over_tcp(free_tcp_port: int) -> None:
    bus, poll = plan(bus__port=str(free_tcp_port), bus__framing='"rtu"')
    async with serving(free_tcp_port, framer=FramerType.RTU) as device:
        assert (await polled(bus, poll))["bridge"] == 1.0
    assert device.written == [(5, 7, [1]), (6, 40, [250])]


def test_the_bytes_of_each_function() -> None:
    bus, poll = plan()
    exchanges = {function_of(one): exchange_bytes(bus, one) for one in poll.exchanges()}
    # header of 7 bytes each way; 5 ask; replies have a byte count, or repeat the request
    assert exchanges[2] == 7 + 5 + 7 + 3
    assert exchanges[5] == exchanges[6] == 7 + 5 + 7 + 5


def test_a_single_write_takes_one_register() -> None:
    wide = "{ address = 40, table = 'holding', type = 'float32' }"
    with pytest.raises(ConfigurationError, match="'single' writes one register"):
        plan(bus__registers__wanted=wide)
