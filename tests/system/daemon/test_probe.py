"""`adaptdrive probe` on a bus with a simulated drive, a sender of junk, and another daemon."""

from __future__ import annotations

import can
import pytest

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.devices.can.bus import open_bus
from tests.support import Process
from tests.system.conftest import MakeSite
from tests.system.daemon.site import PATIENCE_S, BusEar, Site, until

pytestmark = pytest.mark.proof


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    site = make_site()
    site.start_broker()
    site.start_device("--initial-voltage", "280")
    return site


def probe(site: Site, *options: str) -> Process:
    return site.start_process("probe.log", "-m", "adaptdrive.cli", "probe", site.config, *options)


def test_a_probe_shows_refused_frames_and_commands_nothing(site: Site) -> None:
    config = load_configuration(site.config).bus
    assert isinstance(config, CanBus)
    with BusEar(site.config) as ear, open_bus(config) as sender:
        probe(site)
        until(lambda: "v_bst" in site.read("probe.log"), "a reading")
        for can_id, data in ((0x101, bytes(8)), (0x101, bytes(3)), (0x345, b"\x12\x34")):
            sender.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))
        until(lambda: "0x345" in site.read("probe.log"), "the refused frames")
        assert ear.commands() == []
    shown = site.read("probe.log")
    assert "refused 0x101 (DriveLoad): wrong_checksum 1 x, last [00 00 00 00 00 00 00 00]" in shown
    assert "refused 0x101 (DriveLoad): wrong_length 1 x, last [00 00 00]" in shown
    assert "refused 0x345: no entry of [signals] is taken from this id, 1 x, last [12 34]" in shown


def test_asked_to_a_probe_sends_the_safe_command_alone(site: Site) -> None:
    with BusEar(site.config) as ear:
        probe(site, "--safe-command")
        until(lambda: "safe command: sent " in site.read("probe.log"), "an answer")
        commands = ear.commands()
    assert len(commands) >= 30
    assert all(command.safe for command in commands)
    assert "the drive says bridge off, fault 0x0 (before: bridge off, fault 0x0)" in site.read(
        "probe.log"
    )


def test_a_probe_sends_nothing_beside_a_daemon(site: Site) -> None:
    site.start_daemon()
    refused = probe(site, "--safe-command")
    assert refused.wait(PATIENCE_S) == 1
    assert site.daemon is not None
    assert f"is controlled by process {site.daemon.pid}" in site.read("probe.log")
