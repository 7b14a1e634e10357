"""Looking at a drive without touching it: its objects are read over SDO, nothing is written."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

import can

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.control.signals import Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.binding import other_names
from adaptdrive.hardware.canopen.mapping import CanOpenMapping
from adaptdrive.hardware.canopen.profile import POWERED, STATUSWORD, DriveState, state_of
from adaptdrive.hardware.canopen.sdo import SdoThread, Server, describe_node
from adaptdrive.hardware.counting import CountingPort
from adaptdrive.hardware.link.arrival import ArrivalClock
from adaptdrive.hardware.link.bus import describe_bus
from adaptdrive.hardware.link.connection import CanConnection
from adaptdrive.hardware.newest import NewestValues
from adaptdrive.hardware.port import Listener, Reading

_PAUSE_S = 0.2
"""Pause between two readings: five lines a second are as many as can be read."""


class CanOpenWatch(CountingPort):
    """Read-only port to one drive: it sends no command and leaves the node unchanged."""

    complaint = None
    """None: this port cannot energise the drive."""

    safe_s = math.inf
    """Never: nothing is commanded."""

    def __init__(
        self, config: CanOpenBus, mapping: CanOpenMapping, clock: Callable[[], float]
    ) -> None:
        super().__init__()
        self.description = f"{describe_bus(config)} {describe_node(config)}"
        self._config = config
        self._mapping = mapping
        self._clock = clock
        self._connection = CanConnection[Listener](config, self, ArrivalClock(clock), self._counts)
        self._sdo = SdoThread(config, self._connection.put)

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the bus, call `opened`, and read the drive again and again until cancelled.

        Args:
            listener: Receiver of the drive's values.
            opened: Called once, when the bus is open.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        ids = [0x580 + self._config.node_id]
        await self._connection.run(ids, self._serve, listener, opened)

    def send(self, command: Command) -> bool:  # noqa: ARG002 - what a port takes
        """Send nothing."""
        self._counts["send_drops"] += 1
        return False

    def explain_age(self) -> str:
        """Name nothing: nothing is driven from here."""
        return ""

    def hand_out(self) -> None:
        """Nothing waits: a reading is handed out when it is whole."""

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        self._counts["received"] += 1
        if frame.arbitration_id != 0x580 + self._config.node_id or frame.is_extended_id:
            self._counts["foreign"] += 1
        else:
            self._sdo.take_reply(frame)

    async def _serve(self, announce: Callable[[], None]) -> str:
        """Read the drive until the bus is lost; return the reason."""
        announce()
        return await self._connection.read_beside(self._look(), "look")

    async def _look(self) -> None:
        """Read all objects at intervals; report when the drive stops or resumes its replies."""
        reported, listener = "", self._connection.listener
        assert listener is not None  # noqa: S101 - of the connection in use
        while True:
            start_s = self._clock()
            try:
                values, state = await self._sdo.run(self._read)
            except BusError as problem:
                self._counts["timeouts"] += 1
                if str(problem) != reported:
                    reported = str(problem)
                    listener.on_bus(up=False, detail=reported)
            else:
                if reported:
                    reported = ""
                    listener.on_bus(up=True, detail=self.description)
                listener.on_reading(self._reading(values, state, start_s))
            await asyncio.sleep(_PAUSE_S)

    def _read(self, server: Server) -> tuple[dict[str, float], DriveState]:
        """Every quantity, and the drive's state."""
        values = {}
        for source in self._mapping.sources:
            raw = server.value(source.item)
            values[source.quantity] = raw * source.scale + source.offset
        return values, state_of(server.number(STATUSWORD))

    def _reading(self, values: dict[str, float], state: DriveState, start_s: float) -> Reading:
        values["bridge"] = float(state in POWERED)
        slacks, others = dict.fromkeys(values, 0.0), other_names(self._mapping.sources)
        newest = NewestValues(slacks, others, self._mapping.faults)
        newest.keep(values, start_s)
        reading = newest.reading(self._clock(), set_s=start_s)
        assert reading is not None  # noqa: S101 - every value was read
        return reading
