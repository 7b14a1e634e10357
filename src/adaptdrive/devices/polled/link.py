"""A link that is polled: opened, one exchange at a time, and opened again when it is lost."""

import asyncio
import contextlib
import fcntl
import socket
import struct
import termios
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from typing import Generic, TypeVar

from adaptdrive.devices.bus import CountingPort, backoff_s
from adaptdrive.devices.polled.registers import Exchange
from adaptdrive.devices.port import AnyListener
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.clock import find
from adaptdrive.util.errors import AdaptdriveError, BusError

# One exchange at a time with a device that answers, and what can go wrong with it.

Reply = TypeVar("Reply")
Void = Callable[[], bool]
"""Returns whether an exchange is not wanted any more."""

_CONNECT_S = 1.0
"""Longest time to connect: a gateway may be slower to accept than a drive is to answer."""

_LONGEST = 4096
"""Bytes that are kept of what nobody takes."""

_LINGER = struct.Struct("ii")
"""Linux's `struct linger`: whether it applies, and for how many seconds."""

_REFUSED = TripKind.POLL_REFUSED
_COUNT = struct.Struct("i")
"""Answer of the kernel to how much a connection still holds."""


class ExchangeError(AdaptdriveError):
    """An exchange gave nothing that may be used.

    Attributes:
        problem: What went wrong.
        code: Exception code of the device, None where it gave none.
        kind: Kind of the trip that follows where it lasts.
        doubtful: Whether a reply came that may be one to an earlier request.
    """

    doubtful = False

    def __init__(self, problem: str, code: int | None = None, kind: TripKind = _REFUSED) -> None:
        self.problem, self.code, self.kind = problem, code, kind
        super().__init__(problem)


class OvertakenError(ExchangeError):
    """An exchange was not made, as it was no longer wanted: this is no fault of the device."""


def never() -> bool:
    """Return that an exchange is wanted in any case."""
    return False


class Stream(asyncio.Protocol):
    """Bytes that have come from a device, and the way to it.

    Attributes:
        received: Bytes that nobody has taken yet.
        transport: Of the connection, None without one.
        waiting: Whether something that comes may be the reply to a request.
        unasked: Called when something has come that is none.
    """

    def __init__(self) -> None:
        self.received = b""
        self.transport: asyncio.Transport | None = None
        self.waiting = False
        self.unasked: Callable[[], None] = lambda: None
        self._ended = False
        self._changed = asyncio.Event()

    async def connect(self, host: str, port: int) -> None:
        """Connect to the first address of a host that accepts.

        Args:
            host: Name or address.
            port: TCP port.

        Raises:
            OSError: There is no such host, no name server answers in time, or nobody accepts.
            ValueError: The name cannot be one.
        """
        loop, failure = asyncio.get_running_loop(), "it has no address"
        for address in await find(host, port, _CONNECT_S):
            try:
                async with asyncio.timeout(_CONNECT_S):
                    made = await loop.create_connection(lambda: self, address, port)
            except OSError as problem:
                failure = f"no connection: {str(problem) or 'no reply'}"
            else:
                self.transport = made[0]
                self._linger(drop=True)
                return
        raise OSError(failure)

    @property
    def is_open(self) -> bool:
        """True while the connection has not ended."""
        return not (self.transport is None or self._ended or self.transport.is_closing())

    @property
    def undelivered_bytes(self) -> int:
        """Bytes sent on TCP that have not reached the device's end of the connection."""
        link = self._socket
        with contextlib.suppress(OSError):  # a connection that has just ended
            if link is not None:
                queued = fcntl.ioctl(link.fileno(), termios.TIOCOUTQ, bytes(_COUNT.size))
                return int(_COUNT.unpack(queued)[0])
        return 0

    def send(self, data: bytes) -> None:
        """Send bytes; what has come until now is no answer to them."""
        self.received = b""
        if self.transport is not None:
            self.transport.write(data)

    async def more(self) -> None:
        """Wait until more has come, or the connection has ended."""
        self._changed.clear()
        await self._changed.wait()

    def close(self, *, drop: bool) -> None:
        """Disconnect.

        Args:
            drop: Whether requests that the device has not received are dropped: the kernel would
                send them for minutes after the end of the connection, and even of the process. A
                command would reach the drive after the safe command that took its place.
        """
        if self.transport is not None:
            self._linger(drop=drop)
            self.transport.abort() if drop else self.transport.close()
            self.transport = None

    def _linger(self, *, drop: bool) -> None:
        link = self._socket
        with contextlib.suppress(OSError):  # a connection that has just ended keeps nothing either
            if link is not None:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(drop, 0))

    @property
    def _socket(self) -> socket.socket | None:
        """The socket of an open connection over TCP."""
        return self.transport.get_extra_info("socket") if self.transport and self.is_open else None

    def data_received(self, data: bytes) -> None:
        """Keep what comes, and wake whoever waits for it."""
        self.received = (self.received + data)[-_LONGEST:]
        if not self.waiting:
            self.unasked()
        self._changed.set()

    def connection_lost(self, _: Exception | None) -> None:
        """Wake whoever waits: nothing comes any more."""
        self._ended = True
        self._changed.set()


class PolledLink(ABC):
    """An open link to a device that answers each exchange.

    Attributes:
        lost: Why the link can no longer be used, None while it can; `lost_kind` is of what kind.
        asked_s: When the last request was sent; monotonic.
    """

    def __init__(
        self, description: str, timeout_s: float, counts: Counter[str], clock: Callable[[], float]
    ) -> None:
        """Prepare a link; nothing is opened yet.

        Args:
            description: The link in one phrase.
            timeout_s: Longest time from a request to its reply, in s.
            counts: What is counted on it.
            clock: Monotonic clock, in s.
        """
        self._description = description
        self._timeout_s = timeout_s
        self._counts = counts
        self._clock = clock
        self._stream = Stream()
        self._answered = False
        self.lost: str | None = None
        self.lost_kind = TripKind.NO_REPLY
        self.asked_s = clock()

    async def open(self) -> None:
        """Connect.

        Raises:
            BusError: There is no connection.
        """
        try:
            await self._connect()
        except (OSError, ValueError) as problem:
            raise BusError(self._description, str(problem)) from problem

    @abstractmethod
    async def _connect(self) -> None:
        """Connect the stream.

        Raises:
            OSError: There is no connection.
            ValueError: The device has no such setting, or no such name.
        """

    def close(self) -> None:
        """Disconnect; a command that a lost device has not received never reaches it."""
        self._stream.close(drop=self.lost is not None)

    @abstractmethod
    async def exchange(
        self, exchange: Exchange, words: list[int], void: Void | None = never
    ) -> list[int]:
        """Ask for registers, or write some, or both.

        Args:
            exchange: What is read and written.
            words: The registers that are written.
            void: Whether the exchange is not wanted any more, asked until it is sent; None to send
                it at once, whatever may still be on the line.

        Returns:
            The registers that were read.

        Raises:
            ExchangeError: No reply, an exception reply, or one that does not fit; or it is void.
        """

    @abstractmethod
    def suspect(self) -> None:
        """Take what comes next for what is left of something else."""

    def _begin(self, void: Void | None) -> None:
        """Note the time of a request, which must not be sent on a connection that is lost.

        Raises:
            ExchangeError: The connection is lost, or the request is not wanted any more.
        """
        self._note_end()
        if self.lost is not None:
            raise ExchangeError(self.lost, kind=self.lost_kind)
        self.asked_s = self._clock()
        if void is not None and void():  # asked last: the process may have stood still until here
            raise OvertakenError("not sent: it was no longer wanted")

    def _note_end(self) -> None:
        """Take note that the connection has ended, if it has."""
        if self.lost is None and not self._stream.is_open:
            at_once = "" if self._answered else " at once"
            self.lost = f"the device closed the connection{at_once}"

    async def _reply(self, packet: bytes, found: Callable[[bytes], Reply | None]) -> Reply | None:
        """Send a request; return what is found in what comes, None where that is not in time."""
        stream, reply = self._stream, None
        stream.send(packet)
        stream.waiting = True
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._timeout_s):
                while (reply := found(stream.received)) is None and stream.is_open:
                    await stream.more()
        if reply is None:  # it may have come with the end of the time: the process stood still
            reply = found(stream.received)
        stream.waiting = False
        if reply is None:
            self._counts["timeouts"] += 1
            self._note_end()
        self._answered = self._answered or reply is not None
        return reply


# A link that is polled: opened, served until it is lost, and opened again until the end.

Link = TypeVar("Link", bound=PolledLink)

_SILENT_CYCLES = 3
"""Cycles without a reading, or any reply, after which the bus is reported lost."""


class Polling(CountingPort, ABC, Generic[Link, AnyListener]):
    """Parts that the port of a drive and that of sensors have in common.

    Attributes:
        description: The bus in one phrase.
    """

    def __init__(self, description: str, cycle_s: float, clock: Callable[[], float]) -> None:
        super().__init__()
        self.description = description
        self._cycle_s = cycle_s
        self._clock = clock
        self._listener: AnyListener | None = None
        self._up: bool | None = None
        self._wake = asyncio.Event()
        self._closing = self._alike = False
        self._silent = 0
        self._foreign = self._known_foreign = 0

    async def _run(self, link: Link | None, problem: str) -> None:
        """Serve one link after the other until cancelled, and first the open one, if any."""
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
        delays_s = backoff_s(lambda: self._counts["received"])
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
            await self._sleep(next(delays_s))
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
        changed, self._up = self._up is not None or not up, up
        if changed:
            detail = self.description if up else f"{self.description}: {problem}"
            self._listener.on_bus(up=up, detail=detail)
