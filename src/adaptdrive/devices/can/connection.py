"""The connection of a port to its CAN bus: opened, read, sent on, and opened again when lost.

python-can's own adapter spins when a bus is lost and reports no error. This reader reads a bounded
number of frames per wake-up, so that a flood cannot starve the loop, and ends with a lost bus.

After each wake-up it reports that no more frames wait. A port that did not run for a while can
then act once, on the newest of what has piled up, and not once for each.

A bus may take no commands of a drive whose messages come. A full queue of a moment is no sign: the
next tick brings a fresher command. A bus that is lost, or on which nothing comes, takes no commands
either; both are reported as such.
"""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from functools import partial
from typing import Any, Generic, NoReturn, Protocol

import can

from adaptdrive.config.bus import CanLink
from adaptdrive.devices import port
from adaptdrive.devices.bus import backoff_s
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.integrity import ArrivalClock
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.clock import pulsing
from adaptdrive.util.errors import BusError

# Reader of a CAN bus in the event loop.

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
                # a datagram that could not be understood, as opposed to a socket that failed, has
                # a cause other than an error of the system
                if problem.__cause__ is None or isinstance(problem.__cause__, OSError):
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


# The connection of a port to its CAN bus: opened, read, sent on, and opened again when lost.

_UNTAKEN_COMMANDS = 3
"""Commands in a row that a bus refuses while readings come: 25 ms of a drive that sends each half
cycle of 60 Hz, well within its own time-out."""

Serve = Callable[[Callable[[], None]], Awaitable[str]]
"""Use of an open bus until it is lost; calls its argument when it has begun, returns the reason."""


class CanConnection(Generic[port.AnyListener]):
    """One bus of one port.

    Attributes:
        description: The bus in one phrase, in reports of its state.
        bus: The open bus, None while it is lost.
        listener: Receiver of values and of the state of the bus, None before `run`.
        asked: Frames that ask for others, and the time from each to the same again, in s.
        caught_up: Called when frames were taken, and no more of them wait.
    """

    def __init__(
        self, config: CanLink, taker: FrameTaker, arrivals: ArrivalClock, counts: Counter[str]
    ) -> None:
        """Open nothing yet.

        Args:
            config: Which bus.
            taker: Receiver of the frames.
            arrivals: Dates the frames.
            counts: `received`, `sent`, `send_drops` and `reconnects` are counted here.
        """
        self._config = config
        self._taker = taker
        self._arrivals = arrivals
        self._counts = counts
        self._reader: FrameReader | None = None
        self.description = describe_bus(config)
        self.bus: can.BusABC | None = None
        self.listener: port.AnyListener | None = None
        self._reported = True, ""
        self._untaken = 0
        self._reading_came = False
        self.asked: tuple[Sequence[can.Message], float] = (), 0.0
        self.caught_up: Callable[[], None] = lambda: None

    async def run(
        self,
        ids: Iterable[int],
        serve: Serve,
        listener: port.AnyListener,
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
        delays_s = backoff_s(lambda: self._counts["received"] - self._counts["foreign"])
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
            await asyncio.sleep(next(delays_s))

    async def read_after(self, announce: Callable[[], None], stop: Callable[[], object]) -> str:
        """Announce that the bus is in use, and read it until it is lost; return the reason.

        Args:
            announce: Called first.
            stop: Sends the last frame when an error ends the reading.
        """
        try:
            announce()
            return await self.read()
        except Exception:
            stop()
            raise

    async def read(self) -> str:
        """Hand every frame to the taker until the bus is lost; return the reason."""
        if self.bus is None:
            return "closed"
        self._reader = FrameReader(self.bus, self._taker, self._arrivals, self.caught_up)
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

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive: commands do not reach the bus, None for no reason."""
        if self._untaken < _UNTAKEN_COMMANDS:
            return None
        return Trip(
            TripKind.BUS_TAKES_NOTHING,
            f"the bus does not take commands: {self._untaken} in a row were refused while the "
            "drive's messages came; look for another sender that keeps the bus busy, and for an "
            "adapter that sends nothing",
        )

    def note_reading(self) -> None:
        """Note a reading of the drive: the bus is there, and the drive on it."""
        self._reading_came = True

    def note_command(self, *, taken: bool) -> None:
        """Note whether the bus took the whole of a command; of several after a reading one counts.

        Args:
            taken: Whether it did.
        """
        self._untaken = 0 if taken else self._untaken + self._reading_came
        self._reading_came = False

    def report(self, *, up: bool, detail: str = "") -> None:
        """Report the state of the bus to the listener, where it is another than before."""
        before, self._reported = self._reported, (up, detail)
        if self.listener is not None and before != self._reported:
            parts = filter(None, (self.description, detail))
            self.listener.on_bus(up=up, detail=": ".join(parts))

    async def _use(self, bus: can.BusABC, serve: Serve, announce: Callable[[], None]) -> str:
        self.bus = bus
        try:
            return await serve(announce)
        finally:
            self.bus = self._reader = None
            self._untaken, self._reading_came = 0, False
            bus.shutdown()

    def _return(self) -> None:
        self._counts["reconnects"] += 1
        self.report(up=True)

    def _open(self, ids: Iterable[int]) -> can.BusABC:
        self._arrivals.begin_drain()
        self._arrivals.end_drain()
        return open_bus(self._config, ids)
