"""One exchange at a time with a device that answers, and what can go wrong with it."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from typing import TypeVar

from adaptdrive.errors import AdaptdriveError, BusError
from adaptdrive.hardware.polled.capacity import Exchange
from adaptdrive.hardware.polled.stream import Stream

Reply = TypeVar("Reply")
Void = Callable[[], bool]
"""Returns whether an exchange is not wanted any more."""

EXCEPTIONS = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledged, not done yet",
    6: "busy",
    10: "gateway without a path",
    11: "gateway: no reply of the device",
}
"""Codes by which a device says why it does not do what it was asked for (Modbus, 7)."""


class ExchangeError(AdaptdriveError):
    """An exchange gave nothing that may be used."""

    def __init__(self, problem: str, code: int | None = None, *, doubtful: bool = False) -> None:
        """Keep the reason.

        Args:
            problem: What went wrong.
            code: Exception code of the device, None where it gave none.
            doubtful: Whether a reply came that may be one to an earlier request.
        """
        self.problem = problem
        self.code = code
        self.doubtful = doubtful
        super().__init__(problem)


class OvertakenError(ExchangeError):
    """An exchange was not made, as it was no longer wanted: this says nothing of the device."""


def never() -> bool:
    """Return that an exchange is wanted in any case."""
    return False


class PolledLink(ABC):
    """An open link to a device that answers each exchange.

    Attributes:
        lost: Why the link can no longer be used, None while it can.
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

    def _require(self) -> None:
        """Refuse a request on a connection that is lost.

        Raises:
            ExchangeError: It is.
        """
        self._note_end()
        if self.lost is not None:
            raise ExchangeError(self.lost)

    def _note_end(self) -> None:
        """Take note that the connection has ended, if it has."""
        if self.lost is None and not self._stream.is_open:
            at_once = "" if self._answered else " at once"
            self.lost = f"the device closed the connection{at_once}"

    async def _reply(self, packet: bytes, found: Callable[[bytes], Reply | None]) -> Reply | None:
        """Send a request; return what is found in what comes, None where that is not in time."""
        stream, reply = self._stream, None
        stream.send(packet)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._timeout_s):
                while (reply := found(stream.received)) is None and stream.is_open:
                    await stream.more()
        if reply is None:  # it may have come with the end of the time: the process stood still
            reply = found(stream.received)
        self._answered = self._answered or reply is not None
        return reply
