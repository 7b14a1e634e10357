"""Reader of a CAN bus in the event loop.

python-can's own adapter spins when a bus is lost and reports no error. This reader reads a bounded
number of frames per wake-up, so that a flood cannot starve the loop, and ends with a lost bus.

After each wake-up it reports that no more frames wait. A port that did not run for a while can
then act once, on the newest of what has piled up, and not once for each.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

import can

from adaptdrive.hardware.link.arrival import ArrivalClock

_BUDGET = 256
"""Frames read per wake-up; the rest stays in the kernel's queue until the loop has been round. By
default that queue holds as many: one wake-up clears what piled up while the process did not run."""

_POLL_S = 0.001
"""Poll interval of a bus without a file descriptor."""

_HEALTH_S = 0.25
"""Interval of looks at an idle bus: a socket that is closed under the reader never wakes it."""

_BUS_OFF = 0x40
"""Linux: the error class, in the id of an error frame, of a controller that left the bus."""


class FrameTaker(Protocol):
    """Receiver of frames. Called in the event loop; must return at once."""

    def take(self, frame: can.Message) -> None:
        """Take one frame."""

    def take_garbage(self) -> None:
        """Take note of something on the bus that is no frame."""


class FrameReader:
    """Reads one open bus."""

    def __init__(
        self,
        bus: can.BusABC,
        taker: FrameTaker,
        arrivals: ArrivalClock | None = None,
        caught_up: Callable[[], None] = lambda: None,
    ) -> None:
        """Read nothing yet; an event loop must be running.

        Args:
            bus: An open bus.
            taker: Receiver of the frames; an error it raises ends the reading, and `run` raises it.
            arrivals: Notes when the queue is empty, None where frames are not dated.
            caught_up: Called after each wake-up that brought a frame, when no more of them wait.
        """
        self._bus = bus
        self._taker = taker
        self._arrivals = arrivals
        self._caught_up = caught_up
        self._loop = asyncio.get_running_loop()
        self._lost: asyncio.Future[str] = self._loop.create_future()

    async def run(self) -> str:
        """Read until the bus is lost; why it is lost."""
        lost, fileno = self._lost, _fileno(self._bus)
        if fileno >= 0:
            self._loop.add_reader(fileno, self.drain)
        try:
            while not lost.done():
                await asyncio.wait([lost], timeout=_HEALTH_S if fileno >= 0 else _POLL_S)
                self.drain()
            return lost.result()
        finally:
            if fileno >= 0:
                self._loop.remove_reader(fileno)

    def drain(self) -> None:
        """Take the frames that wait, now."""
        if self._lost.done():
            return
        try:
            problem = self._drain()
            self._caught_up()
        except Exception as error:  # noqa: BLE001 - it is raised again, where it can be seen
            self._lost.set_exception(error)
            return
        if problem:
            self._lost.set_result(problem)

    def _drain(self) -> str | None:
        """Read what is there, within the budget; the problem when the bus is lost."""
        bus, taker = self._bus, self._taker
        if self._arrivals is not None:
            self._arrivals.begin_drain()
        for _ in range(_BUDGET):
            try:
                frame = bus.recv(0)
            except BlockingIOError:  # the kernel threw a damaged datagram away after announcing it
                return None
            except can.CanOperationError as problem:
                if not _is_garbage(problem):
                    return str(problem)
                taker.take_garbage()
                continue
            except (can.CanError, OSError, ValueError) as problem:
                return str(problem)
            if frame is None:
                if self._arrivals is not None:
                    self._arrivals.end_drain()
                return None
            if frame.is_error_frame and frame.arbitration_id & _BUS_OFF:
                return "bus-off: the controller has left the bus after too many errors"
            taker.take(frame)
        return None


def _fileno(bus: can.BusABC) -> int:
    try:
        return bus.fileno()
    except NotImplementedError:
        return -1


def _is_garbage(problem: can.CanOperationError) -> bool:
    """Return whether a datagram could not be understood, as opposed to a socket that failed."""
    return problem.__cause__ is not None and not isinstance(problem.__cause__, OSError)
