"""A link that is polled: opened, served until it is lost, and opened again until the end."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from adaptdrive.errors import BusError
from adaptdrive.hardware.counting import BusBackoff, CountingPort
from adaptdrive.hardware.polled.link import PolledLink
from adaptdrive.hardware.port import Listener, SensorListener

Link = TypeVar("Link", bound=PolledLink)
Hearer = TypeVar("Hearer", Listener, SensorListener)

_SILENT_CYCLES = 3
"""Cycles without a reading, or any reply, after which the bus is reported lost."""


class Polling(CountingPort, ABC, Generic[Link, Hearer]):
    """Parts that the port of a drive and that of sensors have in common.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(self, description: str, cycle_s: float, clock: Callable[[], float]) -> None:
        super().__init__()
        self.description = description
        self._cycle_s = cycle_s
        self._clock = clock
        self._listener: Hearer | None = None
        self._up: bool | None = None
        self._wake = asyncio.Event()
        self._closing = self._alike = False
        self._silent = 0
        self._foreign = self._known_foreign = 0

    async def _run(self, link: Link | None, problem: str) -> None:
        """Serve one link after the other until cancelled.

        Args:
            link: An open link, None for the first to be opened later.
            problem: Why it could not be opened.
        """
        worker = asyncio.create_task(self._work(link, problem), name="polling")
        try:
            await asyncio.shield(worker)
        finally:
            # an exchange on a serial line is never cut short, and a drive is left in its safe
            # state, before the line is closed
            self._closing = True
            self._wake.set()
            await worker

    async def _work(self, link: Link | None, problem: str) -> None:
        backoff = BusBackoff(lambda: self._counts["received"])
        while True:
            if link is not None:
                try:
                    await self._serve(link)
                finally:
                    link.close()
                problem = link.lost or "closed"
            if self._closing:
                return
            self._note_bus(up=False, problem=problem)
            self._wake.clear()  # what was urgent when the link was lost does not hurry it back
            await self._sleep(backoff.next_s())
            if self._closing:
                return
            link, problem = await self._try()
            if link is not None:
                self._counts["reconnects"] += self._up is not None

    async def _try(self) -> tuple[Link | None, str]:
        """Open a link; None, and why, where that fails."""
        link = self._new_link()
        try:
            await link.open()
        except BusError as problem:
            return None, problem.problem
        return link, ""

    @abstractmethod
    def _new_link(self) -> Link:
        """Return a link that is not open yet."""

    @abstractmethod
    async def _serve(self, link: Link) -> None:
        """Poll over an open link until it is lost or the port is closed."""

    def _next(self, last_s: float) -> float:
        """The next point of the grid, or the last one that was missed: that poll begins at once."""
        late = max(0.0, self._clock() - last_s)
        return last_s + max(1, int(late / self._cycle_s)) * self._cycle_s

    async def _sleep(self, seconds: float) -> None:
        """Sleep, unless the port is closed or something is urgent."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, seconds)):
                await self._wake.wait()

    def _begin_cycle(self) -> None:
        """Count what nothing asked for from the begin of the last cycle on."""
        self._known_foreign, self._foreign = self._foreign, self._counts["foreign"]

    @property
    def _is_mixed_up(self) -> bool:
        """True if replies came that nothing asked for, and may be taken for others."""
        return self._alike and self._counts["foreign"] > self._known_foreign

    def _note_silence(self, problem: str) -> None:
        """Note a cycle without a reading, or any reply."""
        self._silent += 1
        if self._silent >= _SILENT_CYCLES:
            self._note_bus(up=False, problem=problem)

    @property
    def _was_silent(self) -> bool:
        """True if the bus counts as lost, although its link is open."""
        return self._silent >= _SILENT_CYCLES

    def _note_bus(self, *, up: bool, problem: str = "") -> None:
        """Report whether the bus answers, once it does not, unless the port is being closed."""
        if self._listener is None or self._closing or up is self._up:
            return
        news, self._up = self._up is not None or not up, up
        if news:
            detail = self.description if up else f"{self.description}: {problem}"
            self._listener.on_bus(up=up, detail=detail)
