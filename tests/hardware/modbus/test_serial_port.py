"""A serial port whose opening or closing hangs, as that of a broken USB adapter does.

The call that hangs is released by the event loop: were it to hold up the loop, no test would end.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import serial as pyserial

from adaptdrive.config.modbus import ModbusRtu
from adaptdrive.errors import BusError
from adaptdrive.hardware.modbus.link import ModbusConnection
from adaptdrive.hardware.modbus.serial_port import SerialPort
from adaptdrive.hardware.polled.capacity import Block, Exchange
from adaptdrive.hardware.polled.link import ExchangeError
from tests.config.modbus_documents import parse
from tests.hardware.bench import until
from tests.hardware.modbus.bench import RtuPeer, Wire, serial


class Hang:
    """A call that does not return until it is released, and how often it was begun."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
        self.released = threading.Event()
        self.begun = 0
        real = getattr(owner, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            self.begun += 1
            assert self.released.wait(60.0)
            return real(*args, **kwargs)

        monkeypatch.setattr(owner, name, call)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adaptdrive.hardware.modbus.serial_port.PATIENCE_S", 0.1)


@pytest.fixture
async def line(tmp_path: Path) -> AsyncIterator[ModbusRtu]:
    """A serial line with a device on it."""
    peer = RtuPeer(tmp_path / "drive.tty")
    await peer.start()
    bus = parse(**serial(peer.link)).bus
    assert isinstance(bus, ModbusRtu)
    yield bus
    await peer.stop()


async def opened(bus: ModbusRtu, port: SerialPort) -> ModbusConnection:
    link = ModbusConnection(bus, Counter(), asyncio.get_running_loop().time, serial=port)
    await link.open()
    return link


async def check_that_it_answers(bus: ModbusRtu, port: SerialPort) -> None:
    """Open a link as soon as the port takes it, ask for registers until they come, and close it."""
    async with asyncio.timeout(60.0):
        link = None
        while link is None:
            with contextlib.suppress(BusError):
                link = await opened(bus, port)
        words: list[int] = []
        while not words:
            with contextlib.suppress(ExchangeError):
                words = await link.exchange(Exchange(read=Block("input", 0, 2)), [])
        link.close()


async def test_a_port_that_hangs_while_it_is_opened_is_waited_for_by_one_thread(
    line: ModbusRtu, monkeypatch: pytest.MonkeyPatch
) -> None:
    hang, port = Hang(monkeypatch, pyserial, "serial_for_url"), SerialPort(line)
    for _ in range(3):
        with pytest.raises(BusError, match=r"drive\.tty .*hangs: not opened within 0\.1 s"):
            await opened(line, port)
    assert hang.begun == 1
    hang.released.set()
    await check_that_it_answers(line, port)
    assert hang.begun == 1


async def test_a_port_that_hangs_while_it_is_closed_is_not_opened_beside_it(
    line: ModbusRtu, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = SerialPort(line)
    link = await opened(line, port)
    hang = Hang(monkeypatch, pyserial.Serial, "close")
    link.close()
    for _ in range(3):
        with pytest.raises(BusError, match=r"hangs: not closed within 0\.1 s"):
            await opened(line, port)
    assert hang.begun == 1
    hang.released.set()
    await check_that_it_answers(line, port)


async def test_a_port_that_cannot_be_opened_is_opened_later(line: ModbusRtu) -> None:
    port, moved = SerialPort(line), line.device.with_name("elsewhere")
    line.device.rename(moved)
    with pytest.raises(BusError, match="there is no such serial port"):
        await opened(line, port)
    moved.rename(line.device)
    await check_that_it_answers(line, port)


async def test_the_loop_goes_on_while_the_port_of_a_lost_drive_hangs(
    rtu: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with rtu.bench() as one:
        assert isinstance(one.peer, RtuPeer)
        await one.peer.stop()
        await until(lambda: not one.ear.bus[-1][0] if one.ear.bus else False)
        hang = Hang(monkeypatch, pyserial, "serial_for_url")
        await one.peer.start()
        await until(lambda: hang.begun == 1)
        known = len(one.ear.readings)
        hang.released.set()
        await until(lambda: len(one.ear.readings) > known)
        assert one.ear.bus[-1][0]
