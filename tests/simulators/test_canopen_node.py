"""The simulated CiA 402 node as a process of its own, with the canopen library as its master."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.hardware.link.bus import open_bus
from tests.hardware.canopen.documents import EDS, EXAMPLE, bus_of, parse
from tests.support import Process, Spawn, logged_events

pytestmark = pytest.mark.slow

NODE = 5
PATIENCE_S = 120.0
NOT_MAPPABLE, NOT_NOW, READ_ONLY, NO_OBJECT = 0x06040041, 0x08000022, 0x06010002, 0x06020000


def until(condition: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.02)


class Master:
    """The library's own master of the node."""

    def __init__(self, config: CanOpenBus, process: Process, log: Path) -> None:
        self.network = canopen.Network(open_bus(config))
        self.network.connect()
        self.node = canopen.RemoteNode(NODE, str(EDS))
        self.node.sdo.RESPONSE_TIMEOUT = 2.0
        self.network.add_node(self.node)
        self.process = process
        self._log = log
        until(self._answers, "the node answers")

    def _answers(self) -> bool:
        with contextlib.suppress(canopen.SdoCommunicationError):
            return bool(self.node.sdo[0x1000].raw)
        return False

    def events(self, name: str) -> list[dict[str, Any]]:
        """What the node wrote into its log."""
        return logged_events(self._log, name)

    def states(self) -> list[str]:
        return [event["state"] for event in self.events("power state")]

    def map_pdos(self) -> None:
        """Have the node tell its state after SYNC, and take a controlword with a voltage."""
        tell, take = self.node.tpdo[1], self.node.rpdo[1]
        tell.read()
        take.read()
        tell.clear()
        tell.add_variable(0x6041)
        tell.trans_type = 1
        take.clear()
        take.add_variable(0x6040)
        take.add_variable(0x2000, 4)
        for pdo in (tell, take):
            pdo.enabled = True
            pdo.save()

    def command(self, word: int, voltage_V: float = 250.0) -> None:
        """Send one controlword, and the heartbeat that goes with it."""
        pdo = self.node.rpdo[1]
        pdo[0x6040].raw = word
        pdo[0x2000].raw = voltage_V
        pdo.transmit()
        self.network.send_message(0x77F, b"\x05")

    def climb(self) -> None:
        """Bring the drive to enabled operation."""
        self.node.nmt.state = "OPERATIONAL"
        for number, word in enumerate((0x06, 0x07, 0x0F), start=1):
            self.command(word)
            until(lambda count=number: len(self.states()) == count, f"the answer to {word:#x}")  # type: ignore[misc]

    def statusword(self) -> int:
        """What the node says of its state after SYNC."""
        tell = self.node.tpdo[1]
        tell.is_received = False  # the answer may come before anybody could wait for it
        self.network.sync.transmit()
        until(lambda: tell.is_received, "the state after SYNC")
        return int(tell[0x6041].raw)


@pytest.fixture
def master(tmp_path: Path, free_udp_port: int, spawn: Spawn) -> Iterator[Master]:
    config = bus_of(parse({"bus/udp_port": free_udp_port}))
    text = EXAMPLE.read_text().replace("43116", str(free_udp_port))
    path = tmp_path / "drive.toml"
    path.write_text(text.replace('"cia402.eds"', f'"{EDS}"'))
    process = spawn(sys.executable, "-m", "adaptdrive_sim", "device", path)
    master = Master(config, process, tmp_path / "process-0.log")
    yield master
    master.network.disconnect()


def test_it_says_what_it_is(master: Master) -> None:
    sdo = master.node.sdo
    assert sdo[0x1000].raw & 0xFFFF == 402
    assert (sdo[0x1018][1].raw, sdo[0x1018][2].raw) == (0xAD0, 0x402)
    assert sdo[0x1008].raw == "adaptdrive reference drive"  # longer than one frame
    assert sdo[0x6079].raw == pytest.approx(169_700, abs=300)


def test_it_refuses_what_a_drive_refuses(master: Master) -> None:
    for address, data, code in (
        ((0x1A00, 1), b"\x10\x00\x41\x60", NOT_NOW),
        ((0x1A00, 0), b"\x01", NOT_NOW),
        ((0x1A01, 1), b"\x10\x00\x17\x10", NOT_MAPPABLE),
        ((0x1A01, 1), b"\x08\x00\x41\x60", NOT_MAPPABLE),
        ((0x6041, 0), b"\x00\x00", READ_ONLY),
        ((0x7000, 0), b"\x00\x00", NO_OBJECT),
    ):
        with pytest.raises(SdoAbortedError) as caught:
            master.node.sdo.download(*address, data)
        assert caught.value.code == code, address


def test_it_climbs_under_the_librarys_words_and_tells_so(master: Master) -> None:
    master.map_pdos()
    master.climb()
    assert master.statusword() & 0x6F == 0x27
    assert master.states() == ["READY", "SWITCHED_ON", "ENABLED"]
    master.command(0x00)
    until(lambda: len(master.states()) == 4, "the voltage is disabled")
    assert master.statusword() & 0x4F == 0x40


def test_a_host_that_falls_silent_makes_it_safe(master: Master) -> None:
    emergencies: list[Any] = []
    master.node.emcy.add_callback(emergencies.append)
    master.map_pdos()
    sdo = master.node.sdo
    sdo[0x1016][1].raw = 127 << 16 | 500
    sdo[0x6007].raw = 2
    sdo[0x1017].raw = 50
    master.climb()
    (safe,) = _until_events(master, "safe")
    assert safe["reason"] == "heartbeat lost"
    assert safe["after_ms"] >= 500.0
    until(lambda: len(emergencies) == 1, "an emergency")
    assert emergencies[0].code == 0x8130
    assert master.node.nmt.wait_for_heartbeat(PATIENCE_S) == "PRE-OPERATIONAL"
    master.command(0x06)
    until(lambda: len(emergencies) == 2, "the end of the emergency")
    assert emergencies[1].code == 0
    assert master.states() == ["READY", "SWITCHED_ON", "ENABLED"]


def test_as_the_eds_leaves_it_silence_is_a_fault(master: Master) -> None:
    master.map_pdos()
    master.node.sdo[0x1016][1].raw = 127 << 16 | 500
    master.climb()
    _until_events(master, "safe")
    master.node.nmt.state = "OPERATIONAL"
    assert master.statusword() & 0x4F == 0x08


def test_a_reset_of_the_node_forgets_everything(master: Master) -> None:
    master.map_pdos()
    master.climb()
    master.node.nmt.state = "RESET"
    until(lambda: len(master.events("boot-up")) == 2, "a boot-up")
    assert master.node.sdo[0x1A00][0].raw == 1
    assert master.node.sdo[0x1800][2].raw == 255
    assert master.events("safe")[-1]["reason"] == "restart"


def _until_events(master: Master, name: str) -> list[dict[str, Any]]:
    until(lambda: bool(master.events(name)), name)
    return master.events(name)
