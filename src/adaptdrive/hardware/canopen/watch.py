"""Looking at a drive without touching it: its objects are read over SDO, nothing is written."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from adaptdrive.control.signals import Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.binding import other_names
from adaptdrive.hardware.canopen.node import NodePort
from adaptdrive.hardware.canopen.profile import POWERED, STATUSWORD, DriveState, state_of
from adaptdrive.hardware.canopen.sdo import Server
from adaptdrive.hardware.newest import NewestValues
from adaptdrive.hardware.port import Reading

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
        listener = self._connection.listener
        assert listener is not None  # noqa: S101 - of the connection in use
        while True:
            start_s = self._clock()
            try:
                values, state = await self._sdo.run(self._read)
            except BusError as problem:
                self._counts["timeouts"] += 1
                self._connection.report(up=False, detail=problem.problem)
            else:
                self._connection.report(up=True)
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
