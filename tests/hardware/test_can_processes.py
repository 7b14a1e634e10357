"""The port and a drive in another process, which shares no codec with it."""

import json
import sys
from pathlib import Path

import pytest

from adaptdrive.control.signals import Command
from adaptdrive.hardware.dbc.port import CanPort
from adaptdrive.hardware.port import Reading
from tests.hardware.bench import Ear, build_port, motor_bus, running, until
from tests.support import Spawn

PEER = Path(__file__).with_name("peer.py")


class Answering(Ear):
    """Answers each reading with a command that tells which reading it answers."""

    port: CanPort

    def on_reading(self, reading: Reading) -> None:
        super().on_reading(reading)
        assert reading.counter is not None
        self.port.send(answer(reading.counter))


def answer(counter: int) -> Command:
    return Command(current_scale_S=counter * 1e-5, boost_reference_V=200 + counter / 4, bridge=True)


async def test_each_half_cycle_is_answered(
    spawn: Spawn, free_udp_port: int, tmp_path: Path
) -> None:
    ear, report = Answering(), tmp_path / "heard.json"
    ear.port = build_port(motor_bus(udp_port=free_udp_port))
    async with running(ear.port, ear):
        peer = spawn(sys.executable, PEER, str(free_udp_port), report)
        await until(lambda: peer.poll() is not None)
    assert peer.returncode == 0, (tmp_path / "process-0.log").read_text()
    heard = json.loads(report.read_text())
    assert [entry["half_cycle"] for entry in heard] == list(range(200))
    for number, entry in enumerate(heard):
        expected = answer(entry["half_cycle"])
        assert entry["scale_S"] == pytest.approx(expected.current_scale_S, abs=0.51e-5)
        assert entry["reference_V"] == pytest.approx(expected.boost_reference_V, abs=0.0051)
        assert entry["alive"] == number % 16
    assert [reading.output for reading in ear.readings] == pytest.approx(
        [0.01 * number for number in range(200)]
    )
    assert ear.port.statistics.sent == 200
