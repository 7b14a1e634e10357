"""One daemon for a drive: real processes, and a sender made of python-can alone."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus

from adaptdrive.config import load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.hardware.doubts import QUIET_S
from tests.scenes.system.bus_ear import BusEar
from tests.scenes.system.conftest import MakeSite
from tests.scenes.system.site import PATIENCE_S, Site, motor_configuration, publish, until
from tests.support import Process, start_process, stop_process

_COMMAND_ID = 0x080


@pytest.fixture
def site(make_site: MakeSite) -> Site:
    site = make_site()
    site.start("--initial-voltage", "280")
    return site


def second_start(site: Site) -> subprocess.CompletedProcess[str]:
    """Start a daemon with the same file, its state elsewhere."""
    return subprocess.run(
        [sys.executable, "-m", "adaptdrive.cli", "run", site.config],
        cwd=site.folder,
        env=os.environ | {"STATE_DIRECTORY": str(site.folder / "elsewhere")},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def test_a_second_daemon_is_refused_naming_the_first(site: Site) -> None:
    assert site.daemon is not None
    site.run_drive()
    for _ in range(2):
        refused = second_start(site)
        assert refused.returncode == 1
        assert f"process {site.daemon.pid} of user {os.getuid()}" in refused.stderr
        since = refused.stderr.partition("running since ")[2].partition("Z")[0]
        age_s = (datetime.now(UTC) - datetime.fromisoformat(since + "+00:00")).total_seconds()
        assert 0.0 <= age_s <= 6 * PATIENCE_S
        assert refused.stderr.count("\n") == 1
    assert site.state["state"] == "running"


def test_a_killed_daemon_leaves_no_lock(site: Site) -> None:
    site.kill(site.daemon)
    site.await_availability("offline")
    site.start_daemon()
    site.run_drive()


@pytest.fixture
def twin(site: Site) -> Iterator[Process]:
    """A second daemon for the same drive under another name: no lock can know of it."""
    changes = {**site.changes, "drive.name": '"twin"'}
    config = site.folder / "twin.toml"
    config.write_text(motor_configuration(site.broker_port, site.bus_port, changes))
    site.run_drive()
    command = (sys.executable, "-m", "adaptdrive.cli", "run", config)
    environment = {"STATE_DIRECTORY": str(site.folder / "twin")}
    process = start_process(command, site.folder / "twin.log", environment)
    yield process
    stop_process(process)


def ask_twin(site: Site, verb: str) -> dict[str, Any]:
    """Send the second daemon a command and return its reply."""
    publish(site.broker_port, f"adaptdrive/twin/command/{verb}", f'{{"id": "{time.monotonic()}"}}')
    known = len(replies_of_twin(site))
    return until(lambda: replies_of_twin(site)[known:], "a reply of the twin")[0]


def names_the_rival(reply: dict[str, Any]) -> bool:
    """Whether a refusal says that another sender commands the drive."""
    assert not reply["accepted"]
    return "another sender commands this drive" in reply["reason"]


def replies_of_twin(site: Site) -> list[dict[str, Any]]:
    heard = site.ear._messages()
    return [one.content for one in heard if one.topic == "adaptdrive/twin/reply"]


def test_two_daemons_trip_and_neither_enables(site: Site, twin: Process) -> None:
    tripped = site.await_state(state="tripped")
    assert f"0x{_COMMAND_ID:03X} (DriveCommand)" in tripped["trip"]
    assert tripped["trip"].startswith("another sender commands this drive: ")
    until(lambda: "broker connected" in (site.folder / "twin.log").read_text(), "twin is up")
    with BusEar(site.config) as bus:
        reply = ask_twin(site, "enable")
        assert not reply["accepted"]
        until(lambda: names_the_rival(ask_twin(site, "enable")), "the twin names the other daemon")
        assert not site.ask("reset")["accepted"]
        assert not site.ask("enable")["accepted"]
        until(lambda: len(bus.commands()) > 200, "commands of both")
        assert all(command.safe for command in bus.commands())
    stop_process(twin)
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    site.run_drive()


def test_a_foreign_command_frame_trips_and_decays(site: Site) -> None:
    site.run_drive()
    send_foreign_command(site)
    heard_s = time.monotonic()
    tripped = site.await_state(state="tripped")
    assert "frame 0x080 (DriveCommand)" in tripped["trip"]
    refused = site.ask("reset")
    assert "the bus must be free of its commands for 5 s" in refused["reason"]
    until(lambda: site.ask("reset")["accepted"], "the reset is accepted")
    assert time.monotonic() - heard_s >= 0.9 * QUIET_S
    site.run_drive()


def test_before_enable_a_foreign_command_frame_refuses(site: Site) -> None:
    known = foreign_commands(site)
    send_foreign_command(site)
    until(lambda: foreign_commands(site) > known, "the frame is counted")
    refused = site.ask("enable")
    assert not refused["accepted"]
    assert "another sender commands this drive: 1 x frame 0x080" in refused["reason"]
    assert site.state["state"] == "standby"


def foreign_commands(site: Site) -> int:
    """Foreign commands that the daemon has counted, by its last report."""
    return int(site.ear.on("telemetry/drive")[-1].content["bus"]["foreign_commands"])


def send_foreign_command(site: Site) -> None:
    """Send one command frame from a bus of python-can, whatever its counter and checksum."""
    bus = load_configuration(site.config).bus
    assert isinstance(bus, CanBus)
    frame = can.Message(arbitration_id=_COMMAND_ID, is_extended_id=False, data=bytes(8))
    with UdpMulticastBus(bus.channel, port=bus.udp_port, hop_limit=0) as sender:
        with socket.socket(fileno=os.dup(sender.fileno())) as same:
            loopback = socket.inet_aton("127.0.0.1")
            same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        sender.send(frame)
