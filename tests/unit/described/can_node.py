"""A device on CAN that sends what its manual says, and notes what it is told."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import can


class CanNode:
    """A node on a virtual bus of this process.

    Attributes:
        sends: Bytes of each message that it sends in turn, by id; ids above 0x7FF are of 29 bits.
        heard: The last bytes of each message that it was sent, by id.
        order: Ids that it was sent, in order.
    """

    def __init__(self, channel: str, sends: dict[int, bytes], cycle_s: float = 0.01) -> None:
        self.sends = sends
        self.heard: dict[int, bytes] = {}
        self.order: list[int] = []
        self._channel, self._cycle_s = channel, cycle_s

    @contextlib.asynccontextmanager
    async def served(self) -> AsyncIterator[None]:
        """Send and listen until the block ends."""
        bus = can.Bus(interface="virtual", channel=self._channel)
        task = asyncio.create_task(self._serve(bus))
        try:
            yield
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            bus.shutdown()

    async def _serve(self, bus: can.BusABC) -> None:
        while True:
            for can_id, data in self.sends.items():
                wide = can_id > 0x7FF
                bus.send(can.Message(arbitration_id=can_id, is_extended_id=wide, data=data))
            while (frame := bus.recv(timeout=0.0)) is not None:
                self.heard[frame.arbitration_id] = bytes(frame.data)
                self.order.append(frame.arbitration_id)
            await asyncio.sleep(self._cycle_s)
