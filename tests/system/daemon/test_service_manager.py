"""What systemd would hear of the daemon, on a real datagram socket."""

from __future__ import annotations

import time

from tests.system.conftest import MakeSite
from tests.system.daemon.site import NotifySocket, until

WATCHDOG_S = 0.4
RUNNING = "STATUS=running, fixed controller"
ENABLE = "STATUS=standby, waiting for enable"


def test_the_service_manager_is_told_what_matters(
    make_site: MakeSite, manager: NotifySocket
) -> None:
    site = make_site()
    watchdog_us = str(round(WATCHDOG_S * 1e6))
    site.environment |= {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": watchdog_us}
    site.start_broker()
    site.start_daemon()
    until(lambda: len(manager.messages) >= 2, "the first messages")
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
    with site.stalled(site.daemon):
        manager.catch_up()
        fed = manager.fed
        time.sleep(3 * WATCHDOG_S)
        manager.catch_up()
        assert manager.fed == fed
    until(lambda: manager.fed > fed, "the watchdog is fed again")
    assert site.stop_daemon() == 0
    until(lambda: "STOPPING=1" in manager.messages, "the stop is told")
    assert manager.messages.index("STOPPING=1") > manager.messages.index(RUNNING)


def test_a_daemon_without_a_bus_is_never_ready(make_site: MakeSite, manager: NotifySocket) -> None:
    site = make_site({"bus.interface": '"socketcan"', "bus.channel": '"no-such-can0"'})
    site.environment |= {"NOTIFY_SOCKET": str(manager.path)}
    daemon = site.start_process("daemon.log", "-m", "adaptdrive.cli", "run", site.config)
    assert daemon.wait(timeout=240.0) != 0
    assert "READY=1" not in manager.messages
    assert "Traceback" not in site.daemon_log
