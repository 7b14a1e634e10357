"""A motor held through a CiA 402 drive: state machine, heartbeats, emergencies."""

from __future__ import annotations

import time

import pytest

from tests.system.conftest import MakeSite
from tests.system.daemon.site import Site, until

pytestmark = pytest.mark.proof

CLIMB = ["READY", "SWITCHED_ON", "ENABLED"]
SETTINGS = {"bus.command_timeout_s": "", "bus.heartbeat_timeout_s": "2.0"}
DRIVE_SYNCS = {
    "bus.sync": '"drive"',
    "voltage_loop.where": '"daemon"',
    "signals.counter": '"Boost stage.Half cycles"',
    "signals.fault": '"Error code"',
    "signals.command.current_scale_S": '"0x2000.3"',
}


def power_states(site: Site) -> list[str]:
    """The states that the drive went through, by its own log."""
    return [event["state"] for event in site.device_events("power state")]


def climbed(site: Site, *before: str) -> None:
    """Wait until the drive has climbed to *operation enabled*, after all that went before."""
    until(lambda: power_states(site)[len(before) :] == CLIMB, "operation is enabled")


@pytest.mark.parametrize("changes", [{}, DRIVE_SYNCS], ids=["daemon syncs", "drive syncs"])
def test_a_killed_daemon_leaves_the_drive_safe_and_a_new_one_does_not_energise_it(
    make_site: MakeSite, changes: dict[str, str]
) -> None:
    site = make_site(SETTINGS | changes, "motor-cia402")
    site.start("--initial-voltage", "280")
    assert power_states(site) == []
    site.run_drive()
    climbed(site)
    site.kill(site.daemon)
    (safe,) = until(lambda: site.device_events("safe"), "the drive's safe state")
    assert safe["reason"] == "heartbeat lost"
    assert (safe["current_scale_S"], safe["bridge"], safe["load_current_A"]) == (0.0, False, 0.0)
    site.start_daemon()
    site.await_state(state="standby", enabled=False)
    assert power_states(site) == CLIMB
    until(lambda: site.ask("enable")["accepted"], "the node is set up anew")
    site.await_state(state="running")
    climbed(site, *CLIMB)
    site.demand("disable")
    until(lambda: power_states(site)[6:] == ["SWITCH_ON_DISABLED"], "the voltage is disabled")


def test_a_fault_trips_with_its_emergency_and_is_reset_by_the_operator_alone(
    make_site: MakeSite,
) -> None:
    site = make_site(SETTINGS, "motor-cia402")
    site.start("--initial-voltage", "280")
    site.run_drive()
    climbed(site)
    site.disturb("fault", "1")
    tripped = site.await_state(state="tripped")
    assert tripped["trip"].startswith("node 5: emergency 0x2310, continuous over-current")
    assert "0x2310" in site.ask("reset")["reason"]
    site.disturb("fault", "0")
    time.sleep(0.5)
    assert power_states(site) == CLIMB  # still in its fault: nobody has asked yet
    site.demand("reset")
    left = [*CLIMB, "SWITCH_ON_DISABLED"]
    until(lambda: power_states(site) == left, "the drive leaves its fault")
    site.await_state(state="standby", enabled=False)
    site.run_drive()
    climbed(site, *left)
    site.kill(site.device)
    site.await_state(state="tripped")
    site.start_device("--initial-voltage", "280")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    known = len(power_states(site))
    site.run_drive()
    climbed(site, *power_states(site)[:known])
