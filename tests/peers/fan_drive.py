"""A fan's drive on Modbus TCP with a register map of its own: `fan_drive.py PORT TIMEOUT_s`.

The map is that of docs/own-drive.md, and that of no example.
"""

from __future__ import annotations

import asyncio
import math
import struct
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.peers.drive import LINE_V, Drive, HALF_CYCLE_s, say_ready
from tests.peers.motor import TACHOMETER_Vs

MEASURED, MEASURES = 100, 8
COMMAND, COMMANDS = 2000, 3
ON = 15
INERTIA_kgm2 = 0.0174
FILTER_s = 0.3
RPM = 30.0 / math.pi


class Node:
    """Answers for a drive: 30101 to 30108 measure, 42001 to 42003 command it."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._commands = [0, 0, 0]

    async def access(
        self,
        _function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        written: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Take registers, or renew those that are read; pymodbus chooses the arguments."""
        if written is None:
            first = MEASURED - start
            registers[first : first + MEASURES] = self._measured()
            return None
        if address < COMMAND or address + count > COMMAND + COMMANDS:
            return ExcCodes.ILLEGAL_ADDRESS
        first = address - COMMAND
        self._commands[first : first + count] = [int(word) for word in written]
        control, setpoint, _ = self._commands
        self._drive.command(reference_V=0.1 * setpoint, bridge=control == ON)
        return None

    def _measured(self) -> list[int]:
        drive = self._drive
        speed_rpm = RPM * drive.motor.tachometer_V / TACHOMETER_Vs
        high, low = struct.unpack(">2H", struct.pack(">i", round(100.0 * speed_rpm)))
        (power,) = struct.unpack(">H", struct.pack(">h", round(drive.power_W)))
        boost, line = round(10.0 * drive.boost_V), round(10.0 * LINE_V)
        status = 0x0233 | (4 if drive.bridge else 0)
        return [status, drive.fault, boost, line, power, low, high, drive.half_cycle]

    async def live(self) -> None:
        """Live by half cycles."""
        while True:
            await asyncio.sleep(HALF_CYCLE_s)
            self._drive.live()


async def main(port: int, drive: Drive) -> None:
    """Serve until killed."""
    drive.motor.inertia_kgm2, drive.motor.filter_s = INERTIA_kgm2, FILTER_s
    node = Node(drive)
    blocks = [
        SimData(first, count=count, values=0, datatype=DataType.REGISTERS)
        for first, count in ((MEASURED, MEASURES), (COMMAND, COMMANDS))
    ]
    device = SimDevice(1, blocks, action=node.access)
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    say_ready()
    await node.live()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Drive(0.0, float(sys.argv[2]))))
