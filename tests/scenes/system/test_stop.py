"""A stop on the bus, with real processes: whatever its payload, the disk and the other commands."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import Site, publish, until
from tests.support import slow_disk

GENEROUS_S = 10.0
"""Far above what is measured (docs/proof/reliability.md): this machine is busy with other tests."""

FLOOD = Path(__file__).parents[3] / "tools" / "benchmarks" / "flood.py"
STOP = "adaptdrive/motor/command/disable"


def stopped_after_s(site: Site, ear: BusEar, payload: str, *more: str) -> float:
    """Time from the publication of a stop to the last command that had the bridge on."""
    began_s = time.monotonic()
    publish(site.broker_port, STOP, payload, *more)
    site.await_state(state="standby")
    commands = [command for command in ear.commands() if command.time_s > began_s]
    assert commands[-1].safe
    return max((command.time_s - began_s for command in commands if command.bridge), default=0.0)


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    return make_site()


def test_a_stop_acts_whatever_its_payload(site: Site) -> None:
    site.start("--initial-voltage", "280")
    used = "enable-again"
    expired = json.dumps({"id": "late", "expires": "2001-01-01T00:00:00Z"})
    with BusEar(site.config) as ear:
        for payload in ("", "{}", "OFF", expired, json.dumps({"id": used}), "x" * 20_000):
            site.run_drive()
            publish(site.broker_port, "adaptdrive/motor/command/pole", json.dumps({"id": used}))
            assert stopped_after_s(site, ear, payload) < GENEROUS_S


def test_a_retained_stop_acts_at_the_next_start_only_once(site: Site) -> None:
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


@pytest.mark.slow
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
        assert stopped_after_s(site, ear, json.dumps({"id": "stop"})) < GENEROUS_S
        flooding.terminate()
    assert until(lambda: site._reply("stop"), "a reply")["accepted"]
