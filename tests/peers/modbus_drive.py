"""A drive on Modbus TCP, of its register map: `modbus_drive.py PORT TACHOMETER_V TIMEOUT_s`."""

from __future__ import annotations

import asyncio
import struct
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.peers.drive import LINE_V, Drive, HALF_CYCLE_s, say_ready

REFERENCE, CONTROL, ALIVE = 0, 1, 2
MEASURED = 16
REGISTERS = 24


class Node:
    """Answers for a drive: 40001 to 40003 command it, 40017 to 40024 measure."""

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
            registers[MEASURED - start : REGISTERS - start] = self._measured()
            return None
        if address < REFERENCE or address + count > ALIVE + 1:
            return ExcCodes.ILLEGAL_ADDRESS
        alive = self._commands[ALIVE]
        self._commands[address : address + count] = [int(word) for word in written]
        if self._commands[ALIVE] != alive:
            reference_V = 0.01 * self._commands[REFERENCE]
            self._drive.command(reference_V=reference_V, bridge=self._commands[CONTROL] == 1)
        return None

    def _measured(self) -> list[int]:
        drive = self._drive
        power, high, low = struct.unpack(
            ">3H",
            struct.pack(">hi", round(drive.power_W), round(1e6 * drive.motor.tachometer_V)),
        )
        boost, line = round(100.0 * drive.boost_V), round(10.0 * LINE_V)
        return [boost, line, power, high, low, int(drive.bridge), drive.fault, drive.half_cycle]

    async def live(self) -> None:
        """Live by half cycles, by a clock that drifts from the daemon's."""
        due_s = time.monotonic()
        while True:
            due_s = max(due_s + HALF_CYCLE_s, time.monotonic() - 1.0)
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            self._drive.live()


async def main(port: int, drive: Drive) -> None:
    """Serve until killed."""
    node = Node(drive)
    words = SimData(0, count=REGISTERS, values=0, datatype=DataType.REGISTERS)
    device = SimDevice(1, [words], action=node.access)
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    say_ready()
    await node.live()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Drive(float(sys.argv[2]), float(sys.argv[3]))))
