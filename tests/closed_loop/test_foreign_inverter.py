"""An inverter of another make, known from its DBC alone, is held in closed loop on CAN.

What is on the bus is read by python-can and cantools, and its checksums by crccheck.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from pathlib import Path

import can
import cantools
import pytest
from cantools.database.can.database import Database
from crccheck.crc import Crc8GsmA

from adaptdrive.config import load_configuration
from adaptdrive.control.signals import Mode
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import Disable, SetMode, SetSetpoint
from adaptdrive_sim.device_settings import DeviceSettings
from tests.closed_loop.wire import wired
from tests.hardware.bench import EXAMPLES

DATA_IDS = {0x18FF5F10: 0x5F10, 0x18FF5F11: 0x5F11, 0x18FF5F13: 0x5F13}
START_V = 273.0
SETTLED_s = 22.0 / 4.0
QUICK = {
    "period_s = 1.0": "period_s = 0.25\nsamples = 7",
    "tau_motor_s = 11.7": "tau_motor_s = 2.925",
    "tau_filter_s = 10.0": "tau_filter_s = 2.5",
}
"""The motor with a quarter of its inertia, controlled four times as fast."""
VOLTS_PER_RPM = 2.1502e-3


class Stranger:
    """Listens to the bus with tools that nobody here wrote."""

    def __init__(self, udp_port: int) -> None:
        database = cantools.database.load_file(EXAMPLES / "inverter.dbc")
        assert isinstance(database, Database)
        self._database = database
        self._bus = can.Bus(
            interface="udp_multicast",
            channel="239.74.163.2",
            port=udp_port,
            hop_limit=0,
            ignore_config=True,
        )
        self.values: dict[str, object] = {}
        self.pages: defaultdict[str, set[object]] = defaultdict(set)
        asyncio.get_running_loop().add_reader(self._bus.fileno(), self._take)

    def _take(self) -> None:
        """Check and keep a frame."""
        frame = self._bus.recv(0)
        assert frame is not None
        assert frame.is_extended_id
        data_id, data = DATA_IDS[frame.arbitration_id], bytes(frame.data)
        assert data[7] == Crc8GsmA.calc(data_id.to_bytes(2, "little") + data[:7])
        decoded = self._database.decode_message(frame.arbitration_id, data, allow_truncated=False)
        assert isinstance(decoded, dict)
        self.values |= decoded
        for name in ("ACT_PAGE", "CMD_PAGE"):
            if name in decoded:
                self.pages[name].add(decoded[name])

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._bus.fileno())
        self._bus.shutdown()

    def number(self, name: str) -> float:
        return float(str(self.values[name]))


def example(udp_port: int) -> str:
    text = (EXAMPLES / "motor-inverter.toml").read_text()
    text = text.replace("udp_port = 43113", f"udp_port = {udp_port}")
    text = text.replace('"inverter.dbc"', f'"{EXAMPLES / "inverter.dbc"}"')
    for slow, quick in QUICK.items():
        assert slow in text
        text = text.replace(slow, quick)
    return text


async def test_an_inverter_is_held_that_is_known_from_its_dbc_alone(
    free_udp_port: int, tmp_path: Path
) -> None:
    config = tmp_path / "inverter.toml"
    config.write_text(example(free_udp_port))
    settings = DeviceSettings(initial_voltage_V=START_V)
    stranger = Stranger(free_udp_port)
    async with wired(load_configuration(config), settings, config) as wire:
        await wire.until_running()
        await wire.daemon.execute(SetMode(Mode.ADAPTIVE))
        await wire.daemon.execute(SetSetpoint(3.3))
        await asyncio.sleep(2.0 * SETTLED_s)
        assert (wire.state, wire.daemon._machine.trip) == (State.RUNNING, None)
        assert stranger.values["STATE"] == "Run"
        assert stranger.number("N_ACT") * VOLTS_PER_RPM == pytest.approx(3.3, abs=0.02)
        assert stranger.number("U_DC") == pytest.approx(stranger.number("U_DC_SET"), abs=1.0)
        assert (stranger.values["REQUEST"], stranger.values["MODE"]) == ("Run", "Remote")
        assert stranger.number("I_LIMIT") == 20.0  # the DBC's start value: 400 × 0.05 A
        assert stranger.pages == {"ACT_PAGE": {1, 2, 3}, "CMD_PAGE": {1, 2}}
        statistics = wire.daemon._port.statistics
        assert (statistics.wrong_checksum, statistics.out_of_range, statistics.foreign) == (0, 0, 0)
        await wire.daemon.execute(Disable())
        await asyncio.sleep(1.0)
        assert wire.state is State.STANDBY
        assert (stranger.values["STATE"], stranger.values["REQUEST"]) == ("Off", "Stop")
    stranger.close()
