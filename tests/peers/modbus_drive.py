"""A drive on Modbus TCP, of its register map: `modbus_drive.py PORT TACHOMETER_V TIMEOUT_s`.

40001 to 40003 command the drive, 40017 to 40024 measure it.
"""

from __future__ import annotations

import asyncio
import struct
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.peers.drive import LINE_V, Drive
from tests.peers.modbus_node import ModbusNode

COMMANDS = range(3)
MEASURED = range(16, 24)
REGISTERS = range(24)


def measured(drive: Drive) -> list[int]:
    """Return the content of 40017 to 40024."""
    power, high, low = struct.unpack(
        ">3H", struct.pack(">hi", round(drive.power_W), round(1e6 * drive.motor.tachometer_V))
    )
    boost, line = round(100.0 * drive.boost_V), round(10.0 * LINE_V)
    return [boost, line, power, high, low, int(drive.bridge), drive.fault, drive.half_cycle]


def obey(drive: Drive, before: list[int], words: list[int]) -> None:
    """Command the drive by 40001 to 40003, where the counter of the daemon has moved on."""
    reference, control, alive = words
    if alive != before[2]:
        drive.command(reference_V=0.01 * reference, bridge=control == 1)


async def main(port: int, drive: Drive) -> None:
    """Serve until killed."""
    await ModbusNode(drive, MEASURED, COMMANDS, measured, obey).serve(port, REGISTERS)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Drive(float(sys.argv[2]), float(sys.argv[3]))))
