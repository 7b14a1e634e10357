"""An error in a service of the real process: drive safe on the bus, exit status not 0."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENCE_S, Site, until

SERVICES = {
    "log": ("adaptdrive.app.run", "log_events"),
    "mqtt": ("adaptdrive.operation.service.MqttService", "run"),
    "recorder": ("adaptdrive.recording.recorder.Recorder", "run"),
}
"""Where the coroutine function of each service is found: owner and name."""

DAEMON = """
import asyncio, pkgutil, sys
from pathlib import Path
from adaptdrive.cli import main

owner, name, flag, config = pkgutil.resolve_name(sys.argv[1]), *sys.argv[2:5]
service = getattr(owner, name)

async def failing(*arguments, **named):
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(service(*arguments, **named))
        while not Path(flag).exists():
            await asyncio.sleep(0.01)
        raise ArithmeticError("made to fail")

setattr(owner, name, failing)
sys.exit(main(["run", config]))
"""
"""The daemon, one of whose services fails as soon as a file exists."""


def start(site: Site, service: str, flag: Path) -> None:
    """Start everything; one service of the daemon fails once the flag is there."""
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.daemon = site._start("daemon.log", "-c", DAEMON, *SERVICES[service], flag, site.config)
    site.await_availability("online")
    site.await_measurement()


@pytest.mark.parametrize("service", SERVICES)
def test_an_error_in_a_service_leaves_the_drive_safe(
    make_site: MakeSite, tmp_path: Path, service: str
) -> None:
    site, flag = make_site({"interlocks.stale_s": "1.5"}), tmp_path / "fail"
    start(site, service, flag)
    assert site.daemon is not None
    with BusEar(site.config) as ear:
        site.run_drive()
        until(lambda: ear.commands() and ear.commands()[-1].bridge, "the bridge is commanded on")
        flag.touch()
        assert site.daemon.wait(timeout=PATIENCE_S) != 0
        until(lambda: all(one.safe for one in ear.commands()[-3:]), "safe commands at the end")
    assert "made to fail" in site.daemon_log
