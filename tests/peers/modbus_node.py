"""The frame of a drive on Modbus TCP: some registers measure it, others command it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.peers.drive import Drive, HALF_CYCLE_s, say_ready


class ModbusNode:
    """Answers for a drive until killed."""

    def __init__(
        self,
        drive: Drive,
        measured: range,
        commands: range,
        measure: Callable[[Drive], list[int]],
        obey: Callable[[Drive, list[int], list[int]], None],
    ) -> None:
        """Prepare the registers.

        Args:
            drive: The drive.
            measured: Addresses that `measure` fills.
            commands: Addresses that a master may write.
            measure: Gives the content of the measured registers.
            obey: Commands the drive by the words before a write, and those after it.
        """
        self._drive = drive
        self._measured = measured
        self._commands = commands
        self._measure = measure
        self._obey = obey
        self._words = [0] * len(commands)

    async def serve(self, port: int, *blocks: range) -> None:
        """Live by half cycles, by a clock that drifts from the daemon's.

        Args:
            port: TCP port on loopback.
            blocks: Addresses that exist.
        """
        data = [
            SimData(block.start, count=len(block), values=0, datatype=DataType.REGISTERS)
            for block in blocks
        ]
        device = SimDevice(1, data, action=self._access)
        server = ModbusTcpServer(device, address=("127.0.0.1", port))
        await server.serve_forever(background=True)
        say_ready()
        due_s = time.monotonic()
        while True:
            due_s = max(due_s + HALF_CYCLE_s, time.monotonic() - 1.0)
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            self._drive.live()

    async def _access(
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
            first = self._measured.start - start
            if 0 <= first < len(registers):
                registers[first : first + len(self._measured)] = self._measure(self._drive)
            return None
        if address not in self._commands or address + count > self._commands.stop:
            return ExcCodes.ILLEGAL_ADDRESS
        before, first = list(self._words), address - self._commands.start
        self._words[first : first + count] = [int(word) for word in written]
        self._obey(self._drive, before, self._words)
        return None
