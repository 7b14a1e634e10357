"""Parts that a port which drives a node, and one that only looks at it, have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import can

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.hardware.canopen.mapping import CanOpenMapping
from adaptdrive.hardware.canopen.sdo import SdoLink, describe_node
from adaptdrive.hardware.counting import CountingPort
from adaptdrive.hardware.link.arrival import ArrivalClock
from adaptdrive.hardware.link.bus import describe_bus
from adaptdrive.hardware.link.connection import CanConnection
from adaptdrive.hardware.port import Listener


class NodePort(CountingPort, ABC):
    """One connection to one node.

    Attributes:
        description: The bus in one phrase, such as `socketcan can0 node 5`.
    """

    def __init__(
        self, config: CanOpenBus, mapping: CanOpenMapping, clock: Callable[[], float]
    ) -> None:
        """Prepare for the node; nothing is opened yet.

        Args:
            config: `[bus]`.
            mapping: Which object is which quantity.
            clock: Monotonic clock, in seconds.
        """
        super().__init__()
        self.description = f"{describe_bus(config)} {describe_node(config)}"
        self._config = config
        self._mapping = mapping
        self._clock = clock
        self._arrivals = ArrivalClock(clock)
        self._connection = CanConnection[Listener](config, self, self._arrivals, self._counts)
        self._sdo = SdoLink(config, self._connection.put)
        self._takers: dict[int, Callable[[can.Message], None]] = {
            0x580 + config.node_id: self._sdo.take_reply
        }

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the bus, call `opened`, and serve it until cancelled; reconnect when it is lost.

        A drive that is not there yet is waited for, like one that is switched off.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the bus is open.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        await self._connection.run(self._takers, self._serve, listener, opened)

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        self._counts["received"] += 1
        odd = frame.is_extended_id or frame.is_error_frame or frame.is_remote_frame
        taker = None if odd else self._takers.get(frame.arbitration_id)
        if taker is None:
            self._counts["foreign"] += 1
        else:
            taker(frame)

    def hand_out(self) -> None:
        """Nothing waits: a reading is handed out when it is whole."""

    @abstractmethod
    async def _serve(self, announce: Callable[[], None]) -> str:
        """Use the open bus until it is lost; return the reason."""
