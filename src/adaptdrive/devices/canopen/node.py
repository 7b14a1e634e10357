"""A node that is only looked at, and what it has in common with one that is driven."""

from __future__ import annotations

import asyncio
import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import can

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import Command
from adaptdrive.devices.binding import BRIDGE
from adaptdrive.devices.can.bus import describe_bus
from adaptdrive.devices.can.connection import CanConnection
from adaptdrive.devices.can.integrity import ArrivalClock
from adaptdrive.devices.canopen.mapping import CanOpenMapping
from adaptdrive.devices.canopen.profile import POWERED, STATUSWORD, state_of
from adaptdrive.devices.canopen.reports import newest_values
from adaptdrive.devices.canopen.sdo import SdoLink, Server, describe_node
from adaptdrive.devices.counting import CountingPort
from adaptdrive.devices.port import Listener
from adaptdrive.util.errors import BusError

# Parts that a port which drives a node, and one that only looks at it, have in common.


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


# Looking at a drive without touching it: its objects are read over SDO, nothing is written.

_PAUSE_S = 0.2
"""Pause between two readings: five lines a second are as many as can be read."""


class CanOpenWatch(NodePort):
    """Read-only port to one drive: it sends no command and leaves the node unchanged."""

    complaint = None
    """None: this port cannot energise the drive."""

    safe_s = math.inf
    """Never: nothing is commanded."""

    def send(self, command: Command) -> bool:  # noqa: ARG002 - what a port takes
        """Send nothing."""
        self._counts["send_drops"] += 1
        return False

    def explain_age(self) -> str:
        """Name nothing: nothing is driven from here."""
        return ""

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Read the drive until the bus is lost; return the reason."""
        announce()
        return await self._connection.read_beside(self._look(), "look")

    async def _look(self) -> None:
        """Read all objects at intervals; report when the drive stops or resumes its replies."""
        while True:
            start_s = self._clock()
            try:
                values = await self._sdo.run(self._read)
            except BusError as problem:
                self._counts["timeouts"] += 1
                self._connection.report(up=False, detail=problem.problem)
            else:
                self._connection.report(up=True)
                self._pass_on(values, start_s)
            await asyncio.sleep(_PAUSE_S)

    def _read(self, server: Server) -> dict[str, float]:
        """Every quantity, and whether the bridge is on by the drive's state."""
        values = {
            one.quantity: server.value(one.item) * one.scale + one.offset
            for one in self._mapping.sources
        }
        return values | {BRIDGE: float(state_of(server.number(STATUSWORD)) in POWERED)}

    def _pass_on(self, values: dict[str, float], start_s: float) -> None:
        newest, listener = newest_values(self._mapping), self._connection.listener
        newest.keep(values, start_s)
        reading = newest.reading(self._clock(), set_s=start_s)
        if listener is not None and reading is not None:
            listener.on_reading(reading)
