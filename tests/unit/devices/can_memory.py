"""A CAN bus in memory, with a descriptor that wakes the event loop; python-can's has none.

Frames reach the other ends at once, whatever the machine does besides.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import os
from collections import defaultdict, deque
from typing import Any

import can

_ends: defaultdict[str, list[MemoryBus]] = defaultdict(list)
_Bus = can.Bus


class MemoryBus(can.BusABC):
    """One end of the bus of a channel."""

    def __init__(self, channel: str, protocol: can.CanProtocol = can.CanProtocol.CAN_20) -> None:
        super().__init__(channel)
        self.channel, self.channel_info, self._can_protocol = channel, channel, protocol
        self._waiting: deque[can.Message] = deque()
        self._descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._is_open = True
        _ends[channel].append(self)

    def fileno(self) -> int:
        return self._descriptor

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to all other ends, stamped with the time of the loop."""
        self._check()
        if msg.is_fd and self.protocol is not can.CanProtocol.CAN_FD:
            raise can.CanOperationError("the bus is not one of CAN FD")
        for end in _ends[self.channel]:
            if end is not self:
                frame = copy.deepcopy(msg)
                frame.timestamp = asyncio.get_running_loop().time()
                end._waiting.append(frame)
                os.eventfd_write(end._descriptor, 1)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame, None where none waits."""
        self._check()
        if self._waiting:
            return self._waiting.popleft()
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._descriptor)
        return None

    def shutdown(self) -> None:
        if self._is_open:
            self._is_open = False
            _ends[self.channel].remove(self)
            os.close(self._descriptor)
        super().shutdown()

    def _check(self) -> None:
        if not self._is_open:
            raise can.CanOperationError("the bus is closed")


def open_memory(*words: Any, **named: Any) -> can.BusABC:
    """Open a bus as python-can does, those of this process in memory."""
    if named.get("interface") != "virtual":
        return _Bus(*words, **named)
    return MemoryBus(named["channel"], named.get("protocol", can.CanProtocol.CAN_20))
