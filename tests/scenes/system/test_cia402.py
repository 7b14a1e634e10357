"""A motor held through a CiA 402 drive: state machine, heartbeats, emergencies, restarts."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import can
import pytest

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanOpenBus
from adaptdrive.hardware.link.bus import open_bus
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import EXAMPLES, Site, _with_setting, until

pytestmark = pytest.mark.slow

EDS = EXAMPLES / "cia402.eds"
CLIMB = ["READY", "SWITCHED_ON", "ENABLED"]
HEARTBEAT_TIMEOUT_S = 2.0
STALE_S = 1.5
"""Longer than a machine with more work than processors keeps anybody waiting: nothing here is about
old measurements, and an emergency must be heard before it is."""

BUSY_S = 5.0
"""What such a machine may add to any time."""

DRIVE_SYNCS = {
    "bus.sync": '"drive"',
    "voltage_loop.where": '"daemon"',
    "signals.counter": '"Boost stage.Half cycles"',
    "signals.fault": '"Error code"',
    "signals.command.current_scale_S": '"0x2000.3"',
}


def cia402_site(make_site: MakeSite, changes: Mapping[str, str] | None = None) -> Site:
    """A site with the example of a CiA 402 drive."""
    site = make_site()
    settings = {
        "bus.udp_port": str(site.bus_port),
        "bus.eds": f'"{EDS}"',
        "bus.heartbeat_timeout_s": str(HEARTBEAT_TIMEOUT_S),
        "mqtt.port": str(site.broker_port),
        "interlocks.stale_s": str(STALE_S),
        **(changes or {}),
    }
    lines = (EXAMPLES / "motor-cia402.toml").read_text(encoding="utf-8").splitlines()
    for place, value in settings.items():
        section, _, key = place.rpartition(".")
        lines = _with_setting(lines, f"[{section}]", key, value)
    site.config.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return site


def power_states(site: Site) -> list[str]:
    """The states that the drive went through, by its own log."""
    return [event["state"] for event in site.device_events("power state")]


def last_load(site: Site) -> dict[str, Any]:
    """What the daemon reported of the load last."""
    return site.ear.on("telemetry/load")[-1].content


def climbed(site: Site, *before: str) -> None:
    """Wait until the drive has climbed to *operation enabled*, after all that went before."""
    until(lambda: power_states(site)[len(before) :] == CLIMB, "operation is enabled")


def put(site: Site, can_id: int, data: bytes) -> None:
    """Send one frame, as a stranger on the bus."""
    config = load_configuration(site.config).bus
    assert isinstance(config, CanOpenBus)
    bus = open_bus(config)
    try:
        bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))
    finally:
        bus.shutdown()


@pytest.mark.parametrize("changes", [{}, DRIVE_SYNCS], ids=["daemon syncs", "drive syncs"])
def test_the_motor_is_held_through_a_cia402_drive(
    make_site: MakeSite, changes: dict[str, str]
) -> None:
    site = cia402_site(make_site, changes)
    site.start("--initial-voltage", "280")
    assert power_states(site) == []
    site.run_drive()
    climbed(site)
    held = site.state["setpoint"]
    site.ear.next_on("telemetry/load", after=0)
    site.demand("setpoint", held + 0.1)
    until(lambda: abs(last_load(site)["output"] - held - 0.1) < 0.02, "the new speed", 60.0)
    site.demand("disable")
    until(lambda: power_states(site)[3:] == ["SWITCH_ON_DISABLED"], "the voltage is disabled")
    assert site.state["trip"] is None


def test_a_killed_daemon_leaves_the_drive_safe_and_a_new_one_does_not_energise_it(
    make_site: MakeSite,
) -> None:
    site = cia402_site(make_site)
    site.start("--initial-voltage", "280")
    site.run_drive()
    climbed(site)
    site.kill(site.daemon)
    (safe,) = until(lambda: site.device_events("safe"), "the drive's safe state")
    assert safe["reason"] == "heartbeat lost"
    assert safe["after_ms"] <= 1e3 * (HEARTBEAT_TIMEOUT_S + BUSY_S)
    assert (safe["current_scale_S"], safe["bridge"], safe["load_current_A"]) == (0.0, False, 0.0)
    site.start_daemon()
    site.await_state(state="standby", enabled=False)
    assert power_states(site) == CLIMB
    until(lambda: site.ask("enable")["accepted"], "the node is set up anew")
    site.await_state(state="running")
    climbed(site, *CLIMB)


def test_a_fault_trips_with_its_emergency_and_is_reset_by_the_operator_alone(
    make_site: MakeSite,
) -> None:
    site = cia402_site(make_site)
    site.start("--initial-voltage", "280")
    site.run_drive()
    climbed(site)
    site.disturb("fault", "1")
    tripped = site.await_state(state="tripped")
    assert tripped["trip"] is not None
    assert tripped["trip"].startswith("node 5: emergency 0x2310, continuous over-current")
    reply = site.ask("reset")
    assert not reply["accepted"]
    assert "0x2310" in reply["reason"]
    site.disturb("fault", "0")
    time.sleep(0.5)
    assert power_states(site) == CLIMB  # still in its fault: nobody has asked yet
    site.demand("reset")
    left = [*CLIMB, "SWITCH_ON_DISABLED"]
    until(lambda: power_states(site) == left, "the drive leaves its fault")
    site.await_state(state="standby", enabled=False)
    site.run_drive()
    climbed(site, *CLIMB, "SWITCH_ON_DISABLED")


def test_a_node_that_is_restarted_mid_run_trips_and_is_not_energised_again(
    make_site: MakeSite,
) -> None:
    site = cia402_site(make_site)
    site.start("--initial-voltage", "280")
    site.run_drive()
    climbed(site)
    put(site, 0x000, bytes((0x81, 5)))  # somebody else resets the node
    assert site.await_state(state="tripped")["trip"] == "node 5: has been restarted"
    until(lambda: len(site.device_events("boot-up")) == 2, "the second boot-up")
    site.await_measurement()
    time.sleep(0.5)
    assert power_states(site) == CLIMB
    site.demand("reset")
    time.sleep(0.5)
    assert power_states(site) == CLIMB
    site.run_drive()
    climbed(site, *CLIMB)


def test_a_killed_drive_trips_and_is_set_up_anew_when_it_is_back(make_site: MakeSite) -> None:
    site = cia402_site(make_site)
    site.start("--initial-voltage", "280")
    site.run_drive()
    climbed(site)
    site.kill(site.device)
    site.await_state(state="tripped")
    for verb in ("reset", "enable"):
        assert not site.ask(verb)["accepted"]
    site.start_device("--initial-voltage", "280")
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    assert power_states(site) == CLIMB
    site.run_drive()
    climbed(site, *CLIMB)


def test_the_eds_of_another_drive_is_refused_and_the_drive_left_alone(
    make_site: MakeSite, tmp_path: Path
) -> None:
    site = cia402_site(make_site)
    site.start_broker()
    site.start_device()
    other = tmp_path / "other.eds"
    text = EDS.read_text(encoding="utf-8")
    other.write_text(text.replace("ProductNumber=0x00000402", "ProductNumber=0x00000403"))
    config = site.config.read_text(encoding="utf-8")
    site.config.write_text(config.replace(str(EDS), str(other)), encoding="utf-8")
    site.start_daemon()
    wrong = "is not the drive of other.eds: its product is 0x00000402, the EDS is for 0x00000403"
    until(lambda: wrong in site.daemon_log, "the reason")
    reply = site.ask("enable")
    assert not reply["accepted"]
    assert wrong in reply["reason"]
    assert power_states(site) == []
    assert site.device_events("commanded") == []
