"""What systemd would hear of the daemon, on a real datagram socket."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import until

WATCHDOG_S = 0.4
RUNNING = "STATUS=running, fixed controller"
ENABLE = "STATUS=standby, waiting for enable"


class NotifySocket:
    """The service manager's end; notes what it hears and when."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.heard: list[tuple[float, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.05)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                message = self._socket.recv(4096).decode()
            except TimeoutError:
                continue
            self.heard.append((time.monotonic(), message))

    @property
    def messages(self) -> list[str]:
        return [message for _, message in self.heard]

    @property
    def fed(self) -> int:
        return self.messages.count("WATCHDOG=1")

    def catch_up(self) -> None:
        """Wait until all that was sent before has been noted: datagrams keep their order."""
        known = self.messages.count("CAUGHT_UP=1")
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
            own.sendto(b"CAUGHT_UP=1", str(self.path))
        until(lambda: self.messages.count("CAUGHT_UP=1") > known, "the socket has been read")

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[NotifySocket]:
    notify = NotifySocket(tmp_path / "notify")
    yield notify
    notify.close()


def test_the_service_manager_is_told_what_matters(
    make_site: MakeSite, manager: NotifySocket
) -> None:
    site = make_site()
    watchdog_us = str(round(WATCHDOG_S * 1e6))
    site.environment |= {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": watchdog_us}
    site.start_broker()
    site.start_daemon()
    first, second = manager.messages[:2]
    assert first == "READY=1"
    assert second.startswith("STATUS=udp_multicast ")
    assert second.endswith("waiting for the drive")
    # Nobody is on the bus yet: waiting for a drive is no reason to be restarted.
    fed = manager.fed
    until(lambda: manager.fed >= fed + 5, "the watchdog is fed without a drive")
    site.start_device("--initial-voltage", "280")
    site.await_measurement()
    until(lambda: ENABLE in manager.messages, "the status says what is awaited")
    site.run_drive()
    until(lambda: RUNNING in manager.messages, "the status follows the state")
    _feeds_only_while_it_runs(site.stalled(site.daemon), manager)
    assert site.stop_daemon() == 0
    until(lambda: "STOPPING=1" in manager.messages, "the stop is told")
    assert manager.messages.index("STOPPING=1") > manager.messages.index(RUNNING)


def _feeds_only_while_it_runs(
    stalled: contextlib.AbstractContextManager[None], manager: NotifySocket
) -> None:
    with stalled:
        manager.catch_up()
        fed = manager.fed
        time.sleep(3 * WATCHDOG_S)
        manager.catch_up()
        assert manager.fed == fed
    until(lambda: manager.fed > fed, "the watchdog is fed again")


def test_a_daemon_without_a_bus_is_never_ready(make_site: MakeSite, manager: NotifySocket) -> None:
    site = make_site({"bus.interface": '"socketcan"', "bus.channel": '"no-such-can0"'})
    site.environment |= {"NOTIFY_SOCKET": str(manager.path)}
    daemon = site._start("daemon.log", "-m", "adaptdrive.cli", "run", site.config)
    assert daemon.wait(timeout=240.0) != 0
    assert "READY=1" not in manager.messages
