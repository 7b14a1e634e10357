"""A host is found by its name, and a name server that does not answer keeps nobody waiting."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.app.lock import lock_names
from adaptdrive.config import load_configuration
from adaptdrive.config.file import parse_configuration
from adaptdrive.config.modbus import ModbusTcp
from adaptdrive.errors import BusError
from adaptdrive.hardware.modbus.link import ModbusConnection
from adaptdrive.hardware.polled.capacity import Block, Exchange
from tests.config.modbus_documents import parse
from tests.faults.course import EXAMPLES
from tests.hardware.modbus.bench import TcpPeer


def link_to(host: str, port: int) -> ModbusConnection:
    bus = parse(bus__host=f'"{host}"', bus__port=str(port), bus__timeout_s="0.09").bus
    assert isinstance(bus, ModbusTcp)
    return ModbusConnection(bus, Counter(), time.monotonic)


@pytest.fixture
def silent_name_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Look-ups that end with the test only."""
    answered = threading.Event()

    def wait(*_: object, **__: object) -> None:
        answered.wait()
        raise socket.gaierror(socket.EAI_AGAIN, "try again")

    monkeypatch.setattr(socket, "getaddrinfo", wait)
    yield
    answered.set()


async def test_every_address_of_a_name_is_tried(
    free_tcp_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device has the second one only."""
    found = [
        (socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, free_tcp_port))
        for address in ("127.0.0.9", "127.0.0.1")
    ]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    peer = TcpPeer(free_tcp_port)
    await peer.start()
    link = link_to("drive", free_tcp_port)
    await link.open()
    assert await link.exchange(Exchange(read=Block("input", 0, 2)), []) == [30012, 1204]
    link.close()
    await peer.stop()


async def test_a_name_that_nobody_has_is_named(free_tcp_port: int) -> None:
    with pytest.raises(BusError, match=r"nowhere\.invalid:.*device 1: "):
        await link_to("nowhere.invalid", free_tcp_port).open()


@pytest.mark.usefixtures("silent_name_server")
def test_a_silent_name_server_keeps_neither_the_helper_threads_nor_the_end(
    free_tcp_port: int,
) -> None:
    async def attempts() -> None:
        for _ in range(3):
            with pytest.raises(BusError, match="no name server answers within 1 s"):
                await link_to("drive", free_tcp_port).open()
        assert await asyncio.to_thread(lambda: True)

    started_s = time.monotonic()
    asyncio.run(attempts())
    assert time.monotonic() - started_s < 60.0  # without an end, were it waited for


@pytest.mark.parametrize("host", ["localhost", "127.1", "::ffff:127.0.0.1"])
def test_one_device_has_one_lock_however_its_host_is_written(host: str) -> None:
    one, other = (parse(bus__host=f'"{name}"') for name in ("127.0.0.1", host))
    far = parse(bus__host='"127.0.0.1"', bus__device_id="2")
    shared = {*lock_names(one)} & {*lock_names(other)}
    drive = f"drive {one.drive.name!r}"
    assert shared - {drive}
    assert {*lock_names(one)} & {*lock_names(far)} == {drive}


def test_serial_devices_of_two_folders_have_two_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (EXAMPLES / "motor-modbus-rtu.toml").read_text()
    names = []
    for drive in ("one", "other"):
        folder = tmp_path / drive
        folder.mkdir()
        (folder / "drive.toml").write_text(text.replace('name = "motor"', f'name = "{drive}"'))
        monkeypatch.chdir(folder)
        names.append({*lock_names(load_configuration(Path("drive.toml")))})
        assert names[-1] == {*lock_names(load_configuration(folder / "drive.toml"))}
    assert not names[0] & names[1]


def locks(name: str, device: Path) -> set[str]:
    """Locks of a daemon whose drive, or whose sensors, are on a serial line."""
    document = (EXAMPLES / name).read_text()
    text = re.sub(r'^device = "[^"]*"', f'device = "{device}"', document, flags=re.MULTILINE)
    return {*lock_names(parse_configuration(text, EXAMPLES / name))}


@pytest.mark.parametrize("other", ["motor-modbus-rtu.toml", "bath-thermocouples.toml"])
def test_a_serial_line_has_one_master_whatever_is_on_it(other: str) -> None:
    line = Path("/dev/serial/by-id/usb-FTDI-port0")
    bath = locks("bath-modbus-rtu.toml", line)
    assert locks(other, line) & bath - {"drive 'bath'"} == {f"serial line {line}"}
    assert not locks(other, line.with_name("usb-FTDI-port1")) & bath - {"drive 'bath'"}
