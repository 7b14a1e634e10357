"""The connection of a port to its CAN bus: opened, read, sent on, and opened again when lost."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from functools import partial
from typing import Any, Generic, NoReturn, Protocol, TypeVar

import can

from adaptdrive.clock.tick_timer import pulsing
from adaptdrive.config.bus import CanLink
from adaptdrive.errors import BusError
from adaptdrive.hardware.counting import BusBackoff
from adaptdrive.hardware.doubts import Uptake
from adaptdrive.hardware.link.arrival import ArrivalClock
from adaptdrive.hardware.link.bus import open_bus
from adaptdrive.hardware.link.reader import FrameReader, FrameTaker
from adaptdrive.hardware.port import Listener, SensorListener

Hearer = TypeVar("Hearer", Listener, SensorListener)

Serve = Callable[[Callable[[], None]], Awaitable[str]]
"""Use of an open bus until it is lost; calls its argument when it has begun, returns the reason."""


class FrameUser(FrameTaker, Protocol):
    """A port on a CAN bus."""

    @property
    def description(self) -> str:
        """The bus in one phrase."""

    def hand_out(self) -> None:
        """Pass the newest reading on: no more frames wait."""


class CanConnection(Generic[Hearer]):
    """One bus of one port.

    Attributes:
        bus: The open bus, None while it is lost.
        listener: Receiver of values and of the state of the bus, None before `run`.
        uptake: Whether the open bus takes the commands of its drive.
        asked: Frames that ask for others, and the time from each to the same again, in s.
    """

    def __init__(
        self, config: CanLink, user: FrameUser, arrivals: ArrivalClock, counts: Counter[str]
    ) -> None:
        """Open nothing yet.

        Args:
            config: Which bus.
            user: Receiver of the frames.
            arrivals: Dates the frames.
            counts: `received`, `sent`, `send_drops` and `reconnects` are counted here.
        """
        self._config = config
        self._user = user
        self._arrivals = arrivals
        self._counts = counts
        self._reader: FrameReader | None = None
        self.bus: can.BusABC | None = None
        self.listener: Hearer | None = None
        self._reported = True, ""
        self.uptake = Uptake()
        self.asked: tuple[Sequence[can.Message], float] = (), 0.0

    async def run(
        self,
        ids: Iterable[int],
        serve: Serve,
        listener: Hearer,
        opened: Callable[[], None] | None = None,
    ) -> NoReturn:
        """Serve one bus after the other until cancelled.

        Args:
            ids: Frame ids to receive, all when empty.
            serve: Uses the open bus.
            listener: Receiver of the state of the bus.
            opened: Called once, when the bus is in use for the first time; None where one that
                cannot be opened at the first attempt is tried again, as a lost one is.

        Raises:
            BusError: The bus cannot be opened at the first attempt, and there is an `opened`.
        """
        self.listener, ids = listener, tuple(ids)
        # error frames are received, too: a shorted bus that restarts by itself carries nothing else
        backoff = BusBackoff(lambda: self._counts["received"] - self._counts["foreign"])
        announce, missed = opened or (lambda: None), False
        while True:
            try:
                bus = self._open(ids)
            except BusError as missing:
                if announce is opened:
                    raise
                problem = missing.problem
            else:
                problem, missed = await self._use(bus, serve, announce), False
            if not missed:
                self.report(up=False, detail=problem)
            announce, missed = self._return, True
            await asyncio.sleep(backoff.next_s())

    async def read_after(self, announce: Callable[[], None], farewell: Callable[[], object]) -> str:
        """Announce that the bus is in use, and read it until it is lost; return the reason.

        Args:
            announce: Called first.
            farewell: Sends the last frame when an error ends the reading.
        """
        try:
            announce()
            return await self.read()
        except Exception:
            farewell()
            raise

    async def read(self) -> str:
        """Hand every frame to the user until the bus is lost; return the reason."""
        if self.bus is None:
            return "closed"
        self._reader = FrameReader(self.bus, self._user, self._arrivals, self._user.hand_out)
        frames, period_s = self.asked
        with pulsing(period_s, *[partial(self.send, one) for one in frames]):
            return await self._reader.run()

    def catch_up(self) -> None:
        """Process the frames that have arrived, but were not read yet."""
        if self._reader is not None:
            self._reader.drain()

    async def read_beside(self, work: Coroutine[Any, Any, None], name: str) -> str:
        """Read the bus, and work on it until it is lost; return the reason.

        Args:
            work: Cancelled when the bus is lost.
            name: Name of its task.
        """
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(work, name=name)
            problem = await self.read()
            task.cancel()
        return problem

    def put(self, can_id: int, data: bytes) -> bool:
        """Send a frame with an id of 11 bits at once; return whether the bus took it."""
        return self.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))

    def send(self, frame: can.Message) -> bool:
        """Send a frame at once; return whether the bus took it."""
        try:
            if self.bus is None:
                raise can.CanOperationError("not connected")
            self.bus.send(frame, timeout=0.0)
        except (can.CanError, OSError, ValueError):
            self._counts["send_drops"] += 1
            return False
        self._counts["sent"] += 1
        return True

    def report(self, *, up: bool, detail: str = "") -> None:
        """Report the state of the bus to the listener, where it is another than before."""
        before, self._reported = self._reported, (up, detail)
        if self.listener is not None and before != self._reported:
            parts = [self._user.description, detail]
            self.listener.on_bus(up=up, detail=": ".join(filter(None, parts)))

    async def _use(self, bus: can.BusABC, serve: Serve, announce: Callable[[], None]) -> str:
        self.bus = bus
        try:
            return await serve(announce)
        finally:
            self.bus = self._reader = None
            self.uptake.forget()
            bus.shutdown()

    def _return(self) -> None:
        self._counts["reconnects"] += 1
        self.report(up=True)

    def _open(self, ids: Iterable[int]) -> can.BusABC:
        self._arrivals.begin_drain()
        self._arrivals.end_drain()
        return open_bus(self._config, ids)
