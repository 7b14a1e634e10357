"""The simulated drive outlives an interface that goes down, as a real drive outlives its cable."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.control.signals import SAFE_COMMAND, Command
from tests.support import Spawn, logged_events
from tests.system.daemon.site import PATIENCE_S
from tests.system.daemon.site import until as until_started
from tests.system.vcan.peers import Link
from tests.unit.devices.bench import EXAMPLES, Ear, build_port, running, until

pytestmark = [pytest.mark.vcan, pytest.mark.proof]

COMMAND = Command(current_scale_S=0.01, boost_reference_V=280.0, bridge=True)


async def test_it_is_safe_without_its_interface_and_obeys_again_with_it(
    config: CanBus, spawn: Spawn, tmp_path: Path, link: Link
) -> None:
    ear, log = Ear(), tmp_path / "process-0.log"
    words = ("--interface", "socketcan", "--channel", config.channel, "--initial-voltage", "280")
    spawn(sys.executable, "-m", "adaptdrive_sim", "device", EXAMPLES / "motor.toml", *words)
    until_started(lambda: config.channel in log.read_text(), "the simulated drive", PATIENCE_S)
    port = build_port(config)

    def energised() -> bool:
        port.send(COMMAND)
        return bool(ear.readings) and ear.readings[-1].bridge

    async with running(port, ear):
        await until(energised)
        link("set", "down")
        await until(lambda: bool(logged_events(log, "safe")))
        ear.readings.clear()
        link("set", "up")
        await ear.hears(1)
        assert not ear.readings[0].bridge
        assert not port.send(COMMAND)
        assert "the bus was lost meanwhile" in str(port.trip_cause)
        assert port.send(SAFE_COMMAND)
        await until(energised)
