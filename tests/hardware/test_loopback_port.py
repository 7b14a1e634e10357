import asyncio

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.hardware.port import Port
from tests.hardware.bench import Ear, until
from tests.loopback_port import LoopbackPort
from tests.runtime.bench import CALM


async def test_readings_go_in_and_commands_come_out() -> None:
    sent: list[Command] = []
    ear, loopback = Ear(), LoopbackPort(sent.append)
    port: Port = loopback
    opened = asyncio.Event()
    task = asyncio.create_task(port.run(ear, opened.set))
    await until(opened.is_set)
    loopback.deliver(CALM)
    assert ear.readings == [CALM]
    assert port.send(SAFE_COMMAND)
    assert sent == [SAFE_COMMAND]
    assert (port.statistics.received, port.statistics.sent) == (1, 1)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_lost_bus_carries_nothing_either_way() -> None:
    sent: list[Command] = []
    ear, port = Ear(), LoopbackPort(sent.append, counter_modulus=None)
    assert not port.send(SAFE_COMMAND)
    opened = asyncio.Event()
    task = asyncio.create_task(port.run(ear, opened.set))
    await until(opened.is_set)
    port.lose("unplugged")
    port.deliver(CALM)
    assert not port.send(SAFE_COMMAND)
    port.restore()
    assert port.send(SAFE_COMMAND)
    assert ear.bus == [(False, "unplugged"), (True, "loopback")]
    assert ear.readings == []
    assert (port.statistics.send_drops, port.statistics.reconnects) == (2, 1)
    assert port.counter_modulus is None
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
