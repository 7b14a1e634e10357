"""One line of text at a time to one supply, and its reply.

Nothing numbers the replies. After one that is missing, or that nothing asked for, the next one
could be that to an earlier request: the connection is given up, which no late reply outlives.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable

from adaptdrive.config.modbus import Register
from adaptdrive.config.scpi import ScpiBus
from adaptdrive.errors import BusError
from adaptdrive.hardware.modbus.blocks import Block
from adaptdrive.hardware.modbus.bus import drop_unsent_on
from adaptdrive.hardware.modbus.capacity import Exchange
from adaptdrive.hardware.modbus.codec import count, encode_count
from adaptdrive.hardware.modbus.link import ExchangeError, OvertakenError
from adaptdrive.hosts import find

_CONNECT_S = 2.0
_DONE = "*OPC?"
"""Question that a supply answers with 1 once all earlier commands are complete (IEEE 488.2)."""

_LONGEST_REPLY = 1024


class _Lines(asyncio.Protocol):
    """Collects what has come, and wakes whoever waits for it."""

    def __init__(self) -> None:
        self.received = b""
        self.ended = False
        self.news = asyncio.Event()

    def data_received(self, data: bytes) -> None:
        self.received += data
        self.news.set()

    def connection_lost(self, _: Exception | None) -> None:
        self.ended = True
        self.news.set()


class ScpiConnection:
    """An open connection to one supply.

    Attributes:
        lost: Why it can no longer be used, None while it can.
        asked_s: When the last request was sent; monotonic.
    """

    def __init__(
        self,
        config: ScpiBus,
        registers: dict[str, Register],
        counts: Counter[str],
        clock: Callable[[], float],
        replies: dict[str, str],
    ) -> None:
        """Prepare a connection; nothing is opened yet.

        Args:
            config: Which supply.
            registers: The values as registers, by name.
            counts: What is counted on it.
            clock: Monotonic clock, in s.
            replies: The last reply to each question is kept here.
        """
        self._config = config
        self._registers = {one.address: one for one in registers.values()}
        self._counts = counts
        self._clock = clock
        self._replies = replies
        self._lines = _Lines()
        self._transport: asyncio.Transport | None = None
        self.lost: str | None = None
        self.asked_s = clock()

    async def open(self) -> None:
        """Connect.

        Raises:
            BusError: There is no connection.
        """
        config, loop, failure = self._config, asyncio.get_running_loop(), "it has no address"
        try:
            for address in await find(config.host, config.port, _CONNECT_S):
                try:
                    async with asyncio.timeout(_CONNECT_S):
                        connected = loop.create_connection(
                            lambda: self._lines, address, config.port
                        )
                        transport, _ = await connected
                except OSError as problem:
                    failure = str(problem) or f"no connection within {_CONNECT_S:g} s"
                else:
                    drop_unsent_on(transport, drop=True)
                    self._transport = transport
                    return
        except (OSError, ValueError) as problem:
            failure = str(problem)
        raise BusError(describe_supply(config), failure)

    def close(self) -> None:
        """Disconnect; a command that a lost supply has not received never reaches it."""
        if self._transport is not None:
            drop_unsent_on(self._transport, drop=self.lost is not None)
            self._transport.close() if self.lost is None else self._transport.abort()
            self._transport = None

    def suspect(self) -> None:
        """Give the connection up: a reply may be one to another request."""
        self.lost = self.lost or "a reply came that nothing asked for"

    async def exchange(
        self,
        exchange: Exchange,
        words: list[int],
        *,
        at_once: bool = False,  # noqa: ARG002 - no line has to be silent first
        void: Callable[[], bool] = lambda: False,
    ) -> list[int]:
        """Ask for a value, or set one and wait until the supply has done so.

        Args:
            exchange: What is read or written.
            words: The registers that are written.
            at_once: Ignored.
            void: Whether the exchange is not wanted any more, asked before it is sent.

        Returns:
            The registers of the value that was read.

        Raises:
            ExchangeError: No reply, or one that is no number or not asked for; or it is void.
        """
        if exchange.read is not None:
            return await self._read(exchange.read, void)
        if exchange.write is not None:
            register = self._registers[exchange.write.address]
            line = self._config.value_at(register.address).line(count(register, words))
            reply = await self._ask(f"{line}\n{_DONE}", void)
            if reply.lstrip("+") != "1":
                raise ExchangeError(f"{reply!r} came in reply to {line!r} and {_DONE}")
        return []

    async def _read(self, block: Block, void: Callable[[], bool]) -> list[int]:
        """Return the registers of a value; one that is no number is NaN, or fails."""
        value, register = self._config.value_at(block.address), self._registers[block.address]
        question = value.query or ""
        reply = self._replies[question] = await self._ask(question, void)
        try:
            return encode_count(register, value.number(reply))
        except ValueError as problem:
            raise ExchangeError(f"{reply!r} came in reply to {question!r}") from problem

    async def _ask(self, line: str, void: Callable[[], bool]) -> str:
        """Send a line, and return the line that answers it.

        Raises:
            ExchangeError: There is none.
        """
        transport = self._require()
        self.asked_s = self._clock()
        if void():  # asked last: the process may have stood still until here
            raise OvertakenError("not sent: it was no longer wanted")
        transport.write(f"{line}\n".encode())
        try:
            async with asyncio.timeout(self._config.timeout_s):
                reply = await self._line()
        except TimeoutError:
            self._counts["timeouts"] += 1
            asked = line.partition("\n")[0]
            self.lost = f"no reply within {self._config.timeout_s:g} s to {asked!r}"
            raise ExchangeError(self.lost) from None
        self._counts["received"] += 1
        return reply

    def _require(self) -> asyncio.Transport:
        if self._lines.received:
            self._counts["foreign"] += 1
            self.suspect()
        if self._transport is None or self._lines.ended or self._transport.is_closing():
            self.lost = self.lost or "the device closed the connection"
        if self.lost is not None or self._transport is None:
            raise ExchangeError(self.lost or "closed")
        return self._transport

    async def _line(self) -> str:
        """Return the next line without its end.

        Raises:
            ExchangeError: The connection ends, or the line is too long.
        """
        lines = self._lines
        while b"\n" not in lines.received:
            if lines.ended or len(lines.received) > _LONGEST_REPLY:
                self.lost = "a reply without end" if lines.received else "the connection was closed"
                raise ExchangeError(self.lost)
            lines.news.clear()
            await lines.news.wait()
        line, _, lines.received = lines.received.partition(b"\n")
        return line.decode("ascii", "replace").strip()


def describe_supply(config: ScpiBus) -> str:
    """Return the bus in one phrase, such as `scpi 10.0.0.7:5025`."""
    return f"scpi {config.host}:{config.port}"
