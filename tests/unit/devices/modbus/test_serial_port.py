"""A serial port whose opening or closing hangs, as that of a broken USB adapter does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
from serial import SerialException

from adaptdrive.config.polled import ModbusRtu
from adaptdrive.devices.modbus import link
from adaptdrive.devices.modbus.link import SerialPort
from adaptdrive.devices.polled.link import Stream
from tests.unit.config.modbus_documents import parse
from tests.unit.devices import memory
from tests.unit.devices.bench import until
from tests.unit.devices.modbus.bench import Peer, benched

pytestmark = pytest.mark.usefixtures("memory")
_open = SerialPort.open  # as it is on a line that is not in memory


class Transport:
    """Stands for pymodbus's transport of a serial port, which opens as it is made."""

    def __init__(self, let_close: Callable[[Any], None], *given: Any) -> None:
        self._let_close, self._device = let_close, given[2]
        if str(self._device) not in memory._served:
            raise SerialException

    def set_protocol(self, protocol: asyncio.Protocol) -> None:
        self._end = memory.connect(self._device, protocol)

    def setup(self) -> None:
        """Be set up."""

    def close(self) -> None:
        self._let_close(self._end)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._end, name)


class Threads:
    """Threads whose calls return at once, or when they are released.

    Attributes:
        hangs: Whether they wait.
        begun: How many calls waited.
    """

    def __init__(self) -> None:
        self.hangs = False
        self.begun = 0
        self._waiting: list[Callable[[], None]] = []

    def start(self, call: Callable[[], Any], _: str) -> Future[Any]:
        future: Future[Any] = Future()

        def returns() -> None:
            try:
                future.set_result(call())
            except SerialException as problem:
                future.set_exception(problem)

        if self.hangs:
            self.begun += 1
            self._waiting.append(returns)
        else:
            returns()
        return future

    def release(self) -> None:
        self.hangs = False
        for returns in self._waiting:
            returns()


@pytest.fixture
def threads(memory: None, monkeypatch: pytest.MonkeyPatch) -> Threads:
    found = Threads()
    monkeypatch.setattr(link, "in_thread", found.start)
    monkeypatch.setattr(link, "_Transport", Transport)
    monkeypatch.setattr(link, "PATIENCE_S", 0.1)
    monkeypatch.setattr(SerialPort, "open", _open)
    return found


@pytest.fixture
def peer() -> Peer:
    return Peer("rtu")


@pytest.fixture
def port(peer: Peer) -> SerialPort:
    """A port on whose line there is a device."""
    peer.start()
    bus = parse(**peer.link).bus
    assert isinstance(bus, ModbusRtu)
    return SerialPort(bus)


async def test_a_port_that_hangs_while_it_is_opened_is_waited_for_by_one_thread(
    port: SerialPort, threads: Threads
) -> None:
    threads.hangs = True
    for _ in range(3):
        with pytest.raises(OSError, match=r"hangs: not opened within 0\.1 s"):
            await port.open(Stream())
    assert threads.begun == 1
    threads.release()
    await port.open(Stream())
    assert threads.begun == 1


async def test_a_port_that_hangs_while_it_is_closed_is_not_opened_beside_it(
    port: SerialPort, threads: Threads
) -> None:
    transport = await port.open(Stream())
    threads.hangs = True
    transport.close()
    for _ in range(3):
        with pytest.raises(OSError, match=r"hangs: not closed within 0\.1 s"):
            await port.open(Stream())
    assert threads.begun == 1
    threads.release()
    await port.open(Stream())


async def test_the_loop_goes_on_while_the_port_of_a_lost_drive_hangs(threads: Threads) -> None:
    async with benched("rtu") as one:
        one.peer.stop()
        await one.hears_of_bus(up=False)
        threads.hangs = True
        one.peer.start()
        await until(lambda: threads.begun == 1)
        known = len(one.ear.readings)
        await asyncio.sleep(10.0)
        assert threads.begun == 1
        threads.release()
        await until(lambda: len(one.ear.readings) > known)
        assert one.ear.bus[-1][0]
