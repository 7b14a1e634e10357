"""The simulated drive on CAN, its host made from python-can, cantools and crccheck."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import can
import cantools
import crccheck.crc
import pytest

from adaptdrive.config.file import validate_configuration
from adaptdrive_sim.device import KINDS, DeviceSettings, build_drive
from adaptdrive_sim.devices.can import CanDrive
from adaptdrive_sim.parameters import EXAMPLES, example_tables

EXAMPLE = Path(__file__).parents[3] / "deploy" / "examples" / "motor.toml"
HALF_CYCLE_s = 1.0 / 120.0


class Host:
    """A drive whose frames this host decodes, half cycle by half cycle, under its own clock."""

    def __init__(self) -> None:
        tables = example_tables(EXAMPLE.name)
        configuration = validate_configuration(tables, EXAMPLES / EXAMPLE.name)
        self.events: list[tuple[str, dict[str, Any]]] = []
        settings = DeviceSettings(initial_voltage_V=300.0)
        self._drive = build_drive(configuration, settings, self._report)
        node = KINDS[configuration.bus.type][0](self._drive, configuration, EXAMPLE)
        assert isinstance(node, CanDrive)
        self._node, self._now_s, self.alive = node, 1000.0, 0
        node._clock = lambda: self._now_s
        node._bus = cast("can.BusABC", self)
        database = cantools.database.load_file(EXAMPLE.with_name("adaptdrive.dbc"))
        assert isinstance(database, cantools.database.Database)
        self._database = database
        self.frames: list[tuple[str, dict[str, Any]]] = []

    def _report(self, event: str, **data: object) -> None:
        self.events.append((event, data))

    def named(self, name: str) -> list[dict[str, Any]]:
        return [data for event, data in self.events if event == name]

    def send(self, frame: can.Message) -> None:
        """Take a frame of the drive, which sees this host as its bus."""
        name = self._database.get_message_by_frame_id(frame.arbitration_id).name
        assert frame.data[7] == crccheck.crc.Crc8SaeJ1850.calc(frame.data[:7])
        decoded = self._database.decode_message(name, bytes(frame.data), decode_choices=False)
        assert isinstance(decoded, dict)
        self.frames.append((name, decoded))

    def pass_half_cycles(self, count: int = 1) -> dict[str, Any]:
        """Let time pass; return what was heard last."""
        for _ in range(count):
            self._now_s += HALF_CYCLE_s
            self._node._send(self._drive.tick(self._now_s))
        return dict(self.frames[-1][1]) | dict(self.frames[-2][1])

    def command(self, *, damage: int = 0) -> None:
        """Ask for current with the bridge on; `damage` is laid over the checksum."""
        values = {
            "CurrentScale": 0.03,
            "BoostReference": 310.0,
            "BridgeEnable": 1,
            "CommandAlive": self.alive,
            "CommandCrc": 0,
        }
        self.alive = (self.alive + 1) % 16
        data = bytearray(self._database.encode_message("DriveCommand", values))
        data[7] = crccheck.crc.Crc8SaeJ1850.calc(data[:7]) ^ damage
        frame_id = self._database.get_message_by_name("DriveCommand").frame_id
        self._node.take(can.Message(arbitration_id=frame_id, is_extended_id=False, data=data))

    def commanded(self, count: int) -> dict[str, Any]:
        for _ in range(count):
            self.command()
            heard = self.pass_half_cycles()
        return heard


def test_it_obeys_commands_and_is_safe_100_ms_after_the_last() -> None:
    host = Host()
    heard = host.commanded(20)
    assert (heard["BridgeOn"], heard["LoadPower"] > 400.0, heard["LoadCurrent"] > 4.0) == (1, 1, 1)
    assert host.pass_half_cycles(11)["BridgeOn"] == 1
    heard = host.pass_half_cycles(2)
    assert (heard["BridgeOn"], heard["LoadCurrent"]) == (0, 0.0)
    (safe,) = host.named("safe")
    assert 100.0 <= safe["after_ms"] <= 108.4
    assert safe["reason"] == "command timeout"
    assert host.commanded(2)["BridgeOn"] == 1


def damaged(host: Host) -> None:
    host.command(damage=0x01)


def repeated(host: Host) -> None:
    host.alive = (host.alive - 1) % 16
    host.command()


@pytest.mark.parametrize(
    ("spoilt", "reason"), [(damaged, "wrong_checksum"), (repeated, "counter_stuck")]
)
def test_a_repeated_command_does_not_keep_it_alive(
    spoilt: Callable[[Host], None], reason: str
) -> None:
    """Nor does a damaged one."""
    host = Host()
    assert host.commanded(20)["BridgeOn"] == 1
    for _ in range(14):
        spoilt(host)
        heard = host.pass_half_cycles()
    assert heard["BridgeOn"] == 0
    assert host.named("command refused")[0]["reason"] == reason
