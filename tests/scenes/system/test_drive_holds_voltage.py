"""A drive on CAN that holds its own boost voltage: the daemon sends V_c, samples and watches."""

from __future__ import annotations

import pytest

from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENT_DRIVE, QUICK_MOTOR, Site, until

pytestmark = pytest.mark.slow


def output(site: Site) -> float:
    """The speed, as it was reported last."""
    return float(site.ear.on("telemetry/drive")[-1].content["output"])


def test_the_daemon_sends_v_c_alone_and_the_speed_follows(make_site: MakeSite) -> None:
    site = make_site({**QUICK_MOTOR, "voltage_loop.where": '"drive"'})
    site.start("--initial-voltage", "260", *PATIENT_DRIVE)
    with BusEar(site.config) as bus:
        site.run_drive()
        site.demand("setpoint", 3.1)
        until(lambda: abs(output(site) - 3.1) < 0.03, "the set-point is reached")
        site.let_periods_pass(4)
        report = site.ear.on("telemetry/load")[-1].content
        assert report["output"] == pytest.approx(3.1, abs=0.03)
        assert report["applied_V"] == pytest.approx(report["boost_reference_V"], abs=3.0)
        commands = bus.commands()
        site.demand("disable")
        site.await_state(state="standby")
    assert any(command.bridge for command in commands)
    assert {command.current_scale_S for command in commands} == {0.0}


def test_a_drive_that_goes_silent_trips_the_daemon(make_site: MakeSite) -> None:
    site = make_site({"voltage_loop.where": '"drive"'})
    site.start("--initial-voltage", "260")
    site.run_drive()
    site.kill(site.device)
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("stale: ")
