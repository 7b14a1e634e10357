"""A fan's drive on Modbus TCP with a register map of its own: `fan_drive.py PORT TIMEOUT_s`.

The map is that of docs/own-drive.md, and that of no example: 30101 to 30108 measure the drive,
42001 to 42003 command it.
"""

from __future__ import annotations

import asyncio
import math
import struct
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.peers.drive import LINE_V, Drive
from tests.peers.modbus_node import ModbusNode
from tests.peers.motor import TACHOMETER_Vs

MEASURED = range(100, 108)
COMMANDS = range(2000, 2003)
ON = 15
INERTIA_kgm2 = 0.0174
FILTER_s = 0.3
RPM = 30.0 / math.pi


def measured(drive: Drive) -> list[int]:
    """Return the content of 30101 to 30108."""
    speed_rpm = RPM * drive.motor.tachometer_V / TACHOMETER_Vs
    high, low = struct.unpack(">2H", struct.pack(">i", round(100.0 * speed_rpm)))
    (power,) = struct.unpack(">H", struct.pack(">h", round(drive.power_W)))
    boost, line = round(10.0 * drive.boost_V), round(10.0 * LINE_V)
    status = 0x0233 | (4 if drive.bridge else 0)
    return [status, drive.fault, boost, line, power, low, high, drive.half_cycle]


def obey(drive: Drive, _before: list[int], words: list[int]) -> None:
    """Command the drive by 42001 to 42003, of which the counter has no effect."""
    control, setpoint, _ = words
    drive.command(reference_V=0.1 * setpoint, bridge=control == ON)


async def main(port: int, drive: Drive) -> None:
    """Serve until killed."""
    drive.motor.inertia_kgm2, drive.motor.filter_s = INERTIA_kgm2, FILTER_s
    node = ModbusNode(drive, MEASURED, COMMANDS, measured, obey)
    await node.serve(port, MEASURED, COMMANDS)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Drive(0.0, float(sys.argv[2]))))
