"""The slow loop: a task that turns snapshots into decisions between two ticks."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from adaptdrive.control.signals import Decision, Snapshot

_WAITING_AT_MOST = 3
"""Snapshots that may wait for a decision; the drive trips at the next one."""


class SlowLoop:
    """Decides on every snapshot, in order, outside the tick that took it."""

    def __init__(
        self, decide: Callable[[Snapshot], Decision], deliver: Callable[[Snapshot, Decision], None]
    ) -> None:
        """Join the slow half of the controller to the fast loop.

        Args:
            decide: Makes a decision of a snapshot: the slow half of the controller.
            deliver: Where each decision goes, with the snapshot it was made of.
        """
        self._decide = decide
        self._deliver = deliver
        self._snapshots: asyncio.Queue[Snapshot] = asyncio.Queue(maxsize=_WAITING_AT_MOST)

    def offer(self, snapshot: Snapshot) -> bool:
        """Hand over a snapshot; False when the slow loop has fallen hopelessly behind."""
        try:
            self._snapshots.put_nowait(snapshot)
        except asyncio.QueueFull:
            return False
        return True

    def forget(self) -> None:
        """Drop what waits: the drive has left the run that the snapshots belong to."""
        while not self._snapshots.empty():
            self._snapshots.get_nowait()

    async def run(self) -> None:
        """Decide until cancelled."""
        while True:
            snapshot = await self._snapshots.get()
            self._deliver(snapshot, self._decide(snapshot))
