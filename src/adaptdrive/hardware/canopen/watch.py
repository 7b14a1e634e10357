"""Looking at a drive without touching it: its objects are read over SDO, nothing is written."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from adaptdrive.control.signals import Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.binding import BRIDGE
from adaptdrive.hardware.canopen.node import NodePort
from adaptdrive.hardware.canopen.profile import POWERED, STATUSWORD, state_of
from adaptdrive.hardware.canopen.reports import newest_values
from adaptdrive.hardware.canopen.sdo import Server

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
