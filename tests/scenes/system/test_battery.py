"""A battery charged over a real bus, in real time, by the daemon that its example configures.

All its times are half of the example's.
"""

from __future__ import annotations

import pytest

from tests.scenes.system.conftest import PATIENT_STALE_S, MakeSite
from tests.scenes.system.site import EXAMPLES, PATIENT_DRIVE, Site, _with_setting

pytestmark = pytest.mark.slow

WAVE = {"shape": "square", "low": 6.0, "high": 10.0, "period_s": 10.0}


def battery_site(make_site: MakeSite) -> Site:
    """A site whose drive, still called motor, charges a battery."""
    site = make_site()
    lines = (EXAMPLES / "battery.toml").read_text(encoding="utf-8").splitlines()
    for section, key, value in (
        ("drive", "name", '"motor"'),
        ("bus", "udp_port", str(site.bus_port)),
        ("bus", "database", f'"{EXAMPLES / "battery.dbc"}"'),
        ("mqtt", "port", str(site.broker_port)),
        ("interlocks", "stale_s", PATIENT_STALE_S),
        ("load", "period_s", "0.5"),
        ("load", "samples", "45"),
        ("load.model", "relaxation_s", "15.0"),
        ("estimator", "tau_lambda_s", "10.0"),
    ):
        lines = _with_setting(lines, f"[{section}]", key, value)
    site.config.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return site


def test_the_daemon_brings_the_current_up_and_it_follows_a_wave(make_site: MakeSite) -> None:
    site = battery_site(make_site)
    site.start("--noise", "0.02", *PATIENT_DRIVE)
    site.demand("enable")
    site.await_state(state="running", coasting=True)
    site.demand("setpoint", 10.0)
    site.await_state(state="running", coasting=False)
    site.let_periods_pass(20)
    assert site.ear.on("telemetry/load")[-1].content["output"] == pytest.approx(10.0, abs=0.3)
    site.demand("waveform", WAVE)
    site.let_periods_pass(31)
    reports = [heard.content for heard in site.ear.on("telemetry/load")][-20:]
    settled = [
        now["output"] / now["reference"]
        for before, now in zip(reports[:-8], reports[8:], strict=True)
        if before["reference"] == now["reference"] == reports[-1]["reference"]
    ]
    assert {report["reference"] for report in reports} == {6.0, 10.0}
    assert all(0.9 < share < 1.1 for share in settled)
    assert max(report["output"] for report in reports) < 11.0
    site.demand("disable")
    site.await_state(state="standby")
