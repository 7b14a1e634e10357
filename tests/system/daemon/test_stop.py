"""A stop on the bus, with real processes: whatever its payload, the disk and the other commands."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support import slow_disk
from tests.system.conftest import MakeSite
from tests.system.daemon.site import BusEar, Site, publish, until

FLOOD = Path(__file__).parents[3] / "tools" / "benchmarks" / "flood.py"
STOP = "adaptdrive/motor/command/disable"


def stops(site: Site, ear: BusEar, payload: str) -> None:
    """Publish a stop; the drive is in standby, and its last command is a safe one."""
    publish(site.broker_port, STOP, payload)
    site.await_state(state="standby")
    until(lambda: ear.commands()[-1].safe, "a safe command")


def test_a_stop_acts_whatever_its_payload(make_site: MakeSite) -> None:
    site = make_site()
    site.start("--initial-voltage", "280")
    used = "enable-again"
    expired = json.dumps({"id": "late", "expires": "2001-01-01T00:00:00Z"})
    with BusEar(site.config) as ear:
        for payload in ("", "{}", "OFF", expired, json.dumps({"id": used}), "x" * 20_000):
            site.run_drive()
            publish(site.broker_port, "adaptdrive/motor/command/pole", json.dumps({"id": used}))
            stops(site, ear, payload)


@pytest.mark.proof
def test_a_retained_stop_acts_at_the_next_start_only_once(make_site: MakeSite) -> None:
    site = make_site()
    site.start_broker()
    publish(site.broker_port, STOP, "OFF", "-r")
    site.start_device("--initial-voltage", "280")
    site.start_daemon()
    site.await_measurement()
    until(lambda: any("retained" in heard.payload for heard in site.ear.on("event")), "an event")
    site.run_drive()
    assert site.stop_daemon() == 0
    site.start_daemon()
    site.run_drive()
    assert sum("retained" in heard.payload for heard in site.ear.on("event")) == 1


@pytest.mark.proof
def test_a_stop_overtakes_a_flood_and_a_slow_disk(make_site: MakeSite, tmp_path: Path) -> None:
    environment = slow_disk(tmp_path, 3.0)
    if environment is None:
        pytest.skip("no C compiler")
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    site.environment.update(environment)
    site.start_daemon()
    site.await_measurement()
    site.run_drive()
    flood = [sys.executable, str(FLOOD), str(site.broker_port), "20"]
    with BusEar(site.config) as ear, subprocess.Popen(flood) as flooding:
        time.sleep(4.0)
        stops(site, ear, json.dumps({"id": "stop"}))
        assert flooding.poll() is None
        flooding.terminate()
    assert until(lambda: site.reply_to("stop"), "a reply")["accepted"]
