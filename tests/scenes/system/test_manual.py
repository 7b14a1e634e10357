"""Mode manual on a real bus, by real processes, and its record."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, Site, until


def command(site: Site, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command line against the site's broker."""
    broker = ("--broker", f"127.0.0.1:{site.broker_port}")
    whole = [sys.executable, "-m", "adaptdrive.cli", *words, *broker]
    return subprocess.run(whole, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_an_operator_sets_the_voltage_and_the_record_replays(make_site: MakeSite) -> None:
    site = make_site({"interlocks.stale_s": "0.5", "recording.flush_s": "0.5"})
    site.start("--initial-voltage", "280", *PATIENT_DRIVE)
    refused = site.ask("voltage", 300.0)
    assert refused["reason"] == "voltage needs mode manual; mode is fixed"
    site.demand("mode", "manual")
    site.await_state(voltage_V=200.0)
    site.run_drive()
    for voltage_V in (300.0, 260.0):
        site.demand("voltage", voltage_V)
        site.await_state(mode="manual", controller="manual", voltage_V=voltage_V)
        site.let_periods_pass(2)
    refused = site.ask("voltage", 401.0)
    assert refused["reason"] == "voltage = 401 V is outside 200…400 V"
    site.demand("mode", "fixed")
    site.let_periods_pass(2)
    site.demand("mode", "manual")
    assert command(site, "voltage", "motor", "250", "--hold", "1.5").returncode == 0
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("manual: no new voltage within the 1.5 s")
    assert tripped["last_trip"]["remedy"]
    assert site.stop_daemon() == 0
    replayed = until(site.replay, "the replay")
    assert replayed.returncode == 0, replayed.stdout
    session = site.session()
    assert set(session.ticks["mode"].to_pylist()) == {"fixed", "manual"}
    assert 300.0 in session.ticks["manual_V"].to_pylist()
