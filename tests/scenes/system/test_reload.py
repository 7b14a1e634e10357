"""`reload`: the load and the limits of the file, taken by a running daemon between two runs."""

from __future__ import annotations

import itertools
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from adaptdrive.config.file import digest_of
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, QUICK_MOTOR, Site, motor_configuration, until
from tests.scenes.system.test_service_manager import NotifySocket

SETTINGS = {**QUICK_MOTOR, "interlocks.stale_s": "0.5"}
GUESS = {"load.model.gain": "0.02"}
WAVE = {"shape": "square", "low": 2.9, "high": 3.2, "period_s": 3.0}


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[NotifySocket]:
    notify = NotifySocket(tmp_path / "notify")
    yield notify
    notify.close()


@pytest.fixture
def site(make_site: MakeSite, manager: NotifySocket) -> Site:
    """A site whose daemon has a guess of the load in place of its model."""
    site = make_site(SETTINGS)
    watchdog_us = str(3_000_000)
    site.environment |= {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": watchdog_us}
    site.start_broker()
    site.start_device("--initial-voltage", "280", *PATIENT_DRIVE)
    write(site, {**SETTINGS, **GUESS})
    site.start_daemon()
    site.await_measurement()
    return site


def write(site: Site, changes: dict[str, str], broker_port: int | None = None) -> None:
    port = site.broker_port if broker_port is None else broker_port
    text = motor_configuration(port, site.bus_port, changes)
    site.config.write_text(text, encoding="utf-8")


def reload(site: Site, **fields: object) -> dict[str, object]:
    known = len(site.ear.on("availability"))
    reply = site.ask("reload", **fields)
    if reply["accepted"]:
        site.await_availability("online", after=known + 1)
        site.await_measurement()
    return reply


def assert_fed(manager: NotifySocket) -> None:
    fed = [at_s for at_s, message in manager.heard if message == "WATCHDOG=1"]
    gaps = [after - before for before, after in itertools.pairwise(fed)]
    assert max(gaps) < 3.0


@pytest.mark.slow
def test_a_reload_takes_the_new_load_and_adaptive_is_in_force_at_once(
    site: Site, manager: NotifySocket
) -> None:
    """The model of the file was measured: no warm-up of 90 s comes before adaptive control."""
    daemon = site.daemon
    assert daemon is not None
    write(site, SETTINGS)
    began_s = time.monotonic()
    assert reload(site, measured=digest_of(site.config.read_text()))["accepted"]
    site.run_drive()
    site.demand("mode", "adaptive")
    site.demand("waveform", WAVE)
    site.await_state(state="running", controller="adaptive")
    assert time.monotonic() - began_s < 30.0  # of which this machine's other work takes the most
    assert daemon.poll() is None
    running = [one.payload for one in site.ear.on("state") if '"running"' in one.payload]
    assert running
    site.demand("disable")
    site.await_state(state="standby")
    assert reload(site)["accepted"]  # a second one, between two other runs
    assert site.stop_daemon() == 0
    assert_fed(manager)
    assert manager.messages.count("READY=1") == 3
    assert manager.messages.count("STOPPING=1") == 1
    sessions = sorted((site.folder / "sessions").glob("[!.]*"))
    gains = [
        tomllib.loads((one / "config.toml").read_text())["load"]["model"]["gain"]
        for one in sessions
    ]
    assert gains == [0.02, 0.011, 0.011]
    assert "start from the measured model" in site.daemon_log
    assert "reloaded; changed: [load]" in site.daemon_log


@pytest.mark.slow
def test_the_drive_stays_off_between_two_runs(site: Site) -> None:
    before = len(site.device_events("bridge"))
    assert reload(site)["accepted"]
    assert site.state["state"] == "standby"
    assert len(site.device_events("bridge")) == before


@pytest.mark.slow
def test_what_cannot_be_taken_is_refused_and_nothing_changes(site: Site) -> None:
    daemon = site.daemon
    assert daemon is not None
    write(site, {**SETTINGS, "load.model.gain": '"much"'})
    refusal = reload(site)
    assert not refusal["accepted"]
    assert "is not valid, nothing has changed" in str(refusal["reason"])
    assert "load.model.gain" in str(refusal["reason"])
    write(site, SETTINGS, broker_port=site.broker_port + 1)
    refusal = reload(site)
    assert refusal["reason"] == "a change of [mqtt] needs a restart of the daemon; nothing is new"
    write(site, SETTINGS)
    refusal = reload(site, measured=digest_of("a copy elsewhere"))
    assert "is not the file whose model was measured" in str(refusal["reason"])
    assert "start from the measured model" not in site.daemon_log
    site.demand("enable")
    site.await_state(state="running")
    refusal = reload(site)
    assert refusal["reason"] == "reload needs standby; state is running"
    assert site.state["state"] == "running"
    assert daemon.poll() is None
    assert len(site.ear.on("availability")) == 1


@pytest.mark.slow
def test_a_signal_during_a_reload_ends_the_process(site: Site, manager: NotifySocket) -> None:
    assert site.ask("reload")["accepted"]
    assert site.stop_daemon() == 0
    until(lambda: manager.messages, "it was heard")
