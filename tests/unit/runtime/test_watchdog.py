"""What a service manager hears, on a real datagram socket."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from adaptdrive.runtime.tick_support import ServiceManager


class Ear:
    """The service manager's end."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address.replace("@", "\0", 1))
        self._socket.settimeout(0.0)

    def heard(self) -> list[str]:
        messages: list[str] = []
        while True:
            try:
                messages.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                return messages

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def ear(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Ear]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@{tmp_path}"
    ear = Ear(address)
    yield ear
    ear.close()


def test_it_speaks_the_protocol(ear: Ear) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address})
    manager.ready()
    manager.status("waiting for the drive")
    manager.stopping()
    manager.close()
    assert ear.heard() == ["READY=1", "STATUS=waiting for the drive", "STOPPING=1"]


def test_a_status_is_said_once(ear: Ear) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address})
    for status in ("standby", "standby", "running", "standby"):
        manager.status(status)
    manager.close()
    assert ear.heard() == ["STATUS=standby", "STATUS=running", "STATUS=standby"]


def test_ticks_feed_the_watchdog_four_times_per_period(ear: Ear) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address, "WATCHDOG_USEC": "1000000"})
    heard: list[str] = []
    for tick in range(1200):
        manager.feed(50.0 + tick / 120)
        heard += ear.heard()
    manager.close()
    assert set(heard) == {"WATCHDOG=1"}
    assert 38 <= len(heard) <= 41


@pytest.mark.parametrize("setting", [{}, {"WATCHDOG_USEC": ""}, {"WATCHDOG_USEC": "soon"}])
def test_without_a_watchdog_nothing_is_fed(ear: Ear, setting: dict[str, str]) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address, **setting})
    manager.feed(1.0)
    manager.close()
    assert ear.heard() == []


def test_a_service_manager_that_went_away_does_no_harm(tmp_path: Path) -> None:
    ear = Ear(str(tmp_path / "notify"))
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address})
    ear.close()
    manager.ready()
    manager.close()
    manager.ready()


def test_what_the_service_manager_had_no_room_for_is_sent_again(ear: Ear) -> None:
    manager = ServiceManager({"NOTIFY_SOCKET": ear.address, "WATCHDOG_USEC": "1000000"})
    crowd = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    crowd.settimeout(0.0)
    with suppress(BlockingIOError):
        while True:
            crowd.sendto(b"of another service", ear.address.replace("@", "\0", 1))
    crowd.close()
    manager.ready()
    manager.status("standby")
    manager.status("running")
    manager.feed(1.0)
    assert set(ear.heard()) == {"of another service"}
    manager.feed(1.1)
    manager.close()
    assert ear.heard() == ["READY=1", "STATUS=running", "WATCHDOG=1"]
