"""A bidirectional drive brakes its motor over a real bus, and keeps to what the line takes back."""

from __future__ import annotations

import pytest

from tests.scenes.system.conftest import PATIENT_STALE_S, MakeSite
from tests.scenes.system.site import EXAMPLES, PATIENT_DRIVE, Site, _with_setting, until

LARGEST_S = 0.003


def bidirectional_site(make_site: MakeSite) -> Site:
    """A site with the bidirectional example, and a line that takes little back."""
    site = make_site()
    lines = (EXAMPLES / "motor-bidirectional.toml").read_text(encoding="utf-8").splitlines()
    for section, key, value in (
        ("bus", "udp_port", str(site.bus_port)),
        ("bus", "database", f'"{EXAMPLES / "adaptdrive.dbc"}"'),
        ("mqtt", "port", str(site.broker_port)),
        ("interlocks", "stale_s", PATIENT_STALE_S),
        ("drive.limits", "regeneration_scale_max_S", str(LARGEST_S)),
        ("recording", "flush_s", "0.5"),
    ):
        lines = _with_setting(lines, f"[{section}]", key, value)
    site.config.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return site


@pytest.mark.slow
def test_power_returns_to_the_line_within_its_limit_and_nothing_trips(make_site: MakeSite) -> None:
    site = bidirectional_site(make_site)
    site.start("--initial-voltage", "390", *PATIENT_DRIVE)
    site.run_drive()
    site.demand("setpoint", 4.2)
    site.let_periods_pass(8)
    site.demand("setpoint", 2.6)
    site.let_periods_pass(12)
    assert site.state["trip"] is None
    assert site.stop_daemon() == 0
    replayed = until(site.replay, "the replay")
    assert replayed.returncode == 0, replayed.stdout
    ticks = site.session().ticks
    scales = ticks["current_scale_S"].to_pylist()
    assert min(scales) == pytest.approx(-LARGEST_S, rel=0.01)
    assert scales.count(min(scales)) > 12
    assert min(ticks["load_power_W"].to_pylist()) < -20.0
    assert max(ticks["boost_voltage_V"].to_pylist()) < 430.0
