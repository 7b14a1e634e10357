"""A host is found by its name, and a name server that does not answer keeps nobody waiting."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from adaptdrive.app.process import lock_names
from adaptdrive.config import load_configuration
from adaptdrive.config.file import parse_configuration
from adaptdrive.config.polled import ModbusTcp
from adaptdrive.devices.modbus.link import ModbusConnection
from adaptdrive.devices.polled.link import Stream
from adaptdrive.util.errors import BusError
from tests.integration.faults.course import EXAMPLES
from tests.unit.config.modbus_documents import parse
from tests.unit.devices import memory


async def test_every_address_of_a_name_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """The device has the second one only."""
    addresses = ("127.0.0.9", "127.0.0.1")
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (one, 502)) for one in addresses]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    tried: list[str] = []

    async def create(
        protocol: Callable[[], asyncio.Protocol], address: str, _: int
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        tried.append(address)
        if address == addresses[0]:
            raise ConnectionRefusedError
        made = protocol()
        return memory.End(made), made

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", create)
    await Stream().connect("drive", 502)
    assert tried == [*addresses]


async def test_a_name_that_nobody_has_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "unknown")

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    bus = parse(bus__host='"nowhere.invalid"').bus
    assert isinstance(bus, ModbusTcp)
    with pytest.raises(BusError, match=r"nowhere\.invalid:.*device 1: "):
        await ModbusConnection(bus, Counter(), asyncio.get_running_loop().time).open()


async def test_a_silent_name_server_keeps_neither_the_helper_threads_nor_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each look-up has a thread of its own, which the end does not wait for."""
    answered = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: answered.wait() and [])
    threads = set(threading.enumerate())
    for _ in range(3):
        with pytest.raises(OSError, match="no name server answers within 1 s"):
            await Stream().connect("drive", 502)
    waiting = set(threading.enumerate()) - threads
    assert len(waiting) == 3
    assert all(one.daemon for one in waiting)
    answered.set()


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
