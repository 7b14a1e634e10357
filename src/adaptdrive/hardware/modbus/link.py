"""One exchange at a time with one device, and what can go wrong with it.

A reply that does not belong to its request must never be taken for it. On TCP the transaction id
shows it. On a serial line nothing does: a reply that comes after its time-out would answer the next
request, and every request from then on would be given the reply before. So after a reply has
failed, or after bytes without a request, the line must have been silent for a while before
anything is read again.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Protocol

from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from adaptdrive.config.modbus import RtuLink, TcpLink
from adaptdrive.errors import AdaptdriveError
from adaptdrive.hardware.modbus.blocks import Block
from adaptdrive.hardware.modbus.bus import (
    Client,
    drop_unsent,
    is_connected,
    open_client,
    undelivered_bytes,
)
from adaptdrive.hardware.modbus.capacity import RTU_FRAME, Exchange, silence_s
from adaptdrive.hardware.modbus.replies import answers, explain_exception, explain_other
from adaptdrive.hardware.modbus.serial_port import SerialPort

_SHOWN_BYTES = 16
"""Bytes of what came in place of a reply that a message shows."""

_PATIENCE = 3
"""Replies that may be missing in a row before a TCP connection is taken to be half open."""

_PATIENCE_S = 0.25
"""Time for which they must be missing where the requests arrive: short time-outs are lost in a row
by chance. Where they do not, they are dropped at once: they would arrive with the network."""

_FIRST_S = 2.0
"""The same before the first reply on a connection: a gateway may wake its line for it."""

_SILENT_TIMEOUTS = 2.0
"""Silence after a failure, in time-outs: a reply up to three time-outs old answers nothing."""

_NOISE_ROUNDS = 10
"""Silences for which a line that never falls silent is waited for."""

_LOOK_S = 0.005
"""Time between two looks, while a line is not silent, whether the exchange is still wanted."""


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


class PolledLink(Protocol):
    """An open link to a device that answers each exchange.

    Attributes:
        lost: Why the link can no longer be used, None while it can.
        asked_s: When the last request was sent; monotonic.
    """

    lost: str | None
    asked_s: float

    async def exchange(
        self,
        exchange: Exchange,
        words: list[int],
        *,
        at_once: bool = False,
        void: Callable[[], bool] = lambda: False,
    ) -> list[int]:
        """Ask for registers, or write some, as `ModbusConnection.exchange` does."""

    def suspect(self) -> None:
        """Take what comes next for what is left of something else."""

    def close(self) -> None:
        """Disconnect."""


class ModbusConnection:
    """An open link to one device, or to several that share it.

    Attributes:
        lost: Why the link can no longer be used, None while it can.
        asked_s: When the last request was sent; monotonic.
    """

    def __init__(
        self,
        config: TcpLink | RtuLink,
        counts: Counter[str],
        clock: Callable[[], float],
        *,
        shared: bool = False,
        serial: SerialPort | None = None,
    ) -> None:
        """Prepare a link; nothing is opened yet.

        Args:
            config: Which link.
            counts: What is counted on it.
            clock: Monotonic clock in seconds.
            shared: Whether the link is kept while one device is silent; its owner then calls
                `note_silence` when none answers.
            serial: Port of a serial link, kept by whoever opens the link again.
        """
        self._config = config
        self._serial_port = serial
        self._shared = shared
        self._counts = counts
        self._clock = clock
        self._serial = isinstance(config, RtuLink)
        self._numbered = config.numbered
        self._client: Client | None = None
        self._waiting = False
        self._heard = b""
        self._heard_s = 0.0
        self._transaction = b""
        self._strange = b""
        self._suspect_s: float | None = None if self._numbered else clock()
        self._missed = 0
        self._patience_s = _FIRST_S
        self._replied_s = clock()
        self._commands = False
        self.lost: str | None = None
        self.asked_s = clock()

    @property
    def miss_s(self) -> float:
        """Time for which a missing reply keeps the link busy."""
        silent_timeouts = 0.0 if self._numbered else _SILENT_TIMEOUTS
        return (1.0 + silent_timeouts) * self._config.timeout_s

    async def open(self) -> None:
        """Connect.

        Raises:
            BusError: There is no connection.
        """
        self._client = await open_client(self._config, self._trace, self._serial_port)

    def close(self) -> None:
        """Disconnect; a command that a lost device has not received never reaches it."""
        if self._client is not None:
            if self.lost is None:
                drop_unsent(self._client, drop=False)
            self._client.close()
            self._client = None

    async def exchange(
        self,
        exchange: Exchange,
        words: list[int],
        *,
        at_once: bool = False,
        void: Callable[[], bool] = lambda: False,
    ) -> list[int]:
        """Ask for registers, or write some, or both.

        Args:
            exchange: What is read and written.
            words: The registers that are written.
            at_once: Send it whatever may still be on the line.
            void: Whether the exchange is not wanted any more, asked until it is sent.

        Returns:
            The registers that were read.

        Raises:
            ExchangeError: No reply, an exception reply, or one that does not fit; or it is void.
        """
        if not at_once:
            await self._await_silence(void)
        client = self._require()
        if exchange.write is not None and not self._commands:
            self._commands = True
            drop_unsent(client, drop=True)
        hasty = self.unsettled_s() > 0.0
        self.asked_s = self._clock()
        if not at_once and void():  # asked last: the process may have stood still until here
            raise OvertakenError("not sent: the line was not silent in time")
        reply = await self._reply_to(client, exchange, words)
        await asyncio.sleep(silence_s(self._config))
        registers = self._checked(reply, exchange)
        if hasty:
            raise ExchangeError("a reply that may be one to an earlier request", doubtful=True)
        return registers

    async def _reply_to(self, client: Client, exchange: Exchange, words: list[int]) -> ModbusPDU:
        self._heard, self._waiting = b"", True
        try:
            return await self._request(client, exchange, words)
        except ModbusException as problem:
            self._miss(exchange)
            silence = f"no reply within {self._config.timeout_s:g} s"
            raise ExchangeError(f"{silence}{self._came_instead(exchange)}") from problem
        finally:
            self._waiting = False

    def _require(self) -> Client:
        if self._client is None or not is_connected(self._client):
            self.lost = self.lost or "the connection was closed"
            raise ExchangeError(self.lost)
        return self._client

    def _request(
        self, client: Client, exchange: Exchange, words: list[int]
    ) -> Awaitable[ModbusPDU]:
        read, write = exchange.read, exchange.write
        device = self._device_of(exchange)
        if read is None:
            return _write(client, write, words, device)
        if write is not None:
            return client.readwrite_registers(
                read_address=read.address,
                read_count=read.count,
                write_address=write.address,
                values=words,
                device_id=device,
            )
        ask = {
            "coil": client.read_coils,
            "discrete": client.read_discrete_inputs,
            "holding": client.read_holding_registers,
            "input": client.read_input_registers,
        }[read.table]
        return ask(read.address, count=read.count, device_id=device)

    def _device_of(self, exchange: Exchange) -> int:
        return self._config.device_id if exchange.device_id is None else exchange.device_id

    def _miss(self, exchange: Exchange) -> None:
        """Count a missing reply, and what came in its place."""
        self.suspect()
        self._missed += 1
        self._counts["timeouts"] += 1
        if self._client is None or not is_connected(self._client):
            self.lost = "the device closed the connection"
        elif not self._numbered and self._heard:
            short = len(self._heard) < exchange.reply_bytes + RTU_FRAME
            self._counts["wrong_length" if short else "wrong_checksum"] += 1
        elif not self._shared:
            self.note_silence()

    def note_silence(self) -> None:
        """Take a TCP connection on which no device answers for half open, after some replies."""
        if self.lost is not None or self._serial or self._missed < _PATIENCE:
            return
        stuck = self._client is not None and undelivered_bytes(self._client) > 0
        if stuck or self._clock() - self._replied_s >= self._patience_s:
            self.lost = f"no reply to {self._missed} requests in a row"

    def _came_instead(self, exchange: Exchange) -> str:
        """Return what came in place of a reply, empty where nothing came."""
        if not self._heard:
            return ""
        if not self._numbered:
            more = "…" if len(self._heard) > _SHOWN_BYTES else ""
            return f"; bytes that are no reply: {self._heard[:_SHOWN_BYTES].hex(' ')}{more}"
        transaction = int.from_bytes(self._transaction)
        return f"; {explain_other(self._heard, transaction, self._device_of(exchange))}"

    def _checked(self, reply: ModbusPDU, exchange: Exchange) -> list[int]:
        self._missed, self._replied_s, self._patience_s = 0, self._clock(), _PATIENCE_S
        if self._numbered and reply.transaction_id != int.from_bytes(self._transaction):
            self._counts["foreign"] += 1
            raise ExchangeError("a reply with another transaction id")
        if reply.isError():
            self._counts["exceptions"] += 1
            code = getattr(reply, "exception_code", 0)
            raise ExchangeError(explain_exception(code, exchange), code)
        if not answers(reply, exchange):
            self.suspect()
            self._counts["foreign"] += 1
            raise ExchangeError("a reply that belongs to another request")
        self._counts["received"] += 1
        if exchange.read is None:
            return []
        if exchange.read.table in {"coil", "discrete"}:
            return [int(bit) for bit in reply.bits[: exchange.read.count]]
        return list(reply.registers)

    async def _await_silence(self, void: Callable[[], bool]) -> None:
        """Let what may still come from an earlier request pass by unread, while it is wanted.

        Raises:
            ExchangeError: The line is never silent.
        """
        end_s = self._clock() + _NOISE_ROUNDS * _SILENT_TIMEOUTS * self._config.timeout_s
        while (left_s := self.unsettled_s()) > 0.0 and not void():
            if self._clock() > end_s:
                raise ExchangeError("the line is never silent")
            await asyncio.sleep(min(left_s, _LOOK_S))

    def unsettled_s(self) -> float:
        """Return how much longer a serial line must be silent before a reply is its request's."""
        if self._suspect_s is None:
            return 0.0
        silent_s = _SILENT_TIMEOUTS * self._config.timeout_s
        left_s = max(self._suspect_s, self._heard_s) + silent_s - self._clock()
        if left_s <= 0.0:
            self._suspect_s = None
        return left_s

    def suspect(self) -> None:
        """Take what comes next on a serial line for what is left of something else."""
        if not self._numbered:
            self._suspect_s = self._clock()

    def _trace(self, sending: bool, packet: bytes) -> bytes:
        """See every packet as pymodbus does."""
        if sending:
            self._transaction = packet[:2]
        else:
            self._heard, self._heard_s = packet, self._clock()
            self._note_foreign(packet)
        return packet

    def _note_foreign(self, packet: bytes) -> None:
        """Count what no request waits for: noise, a late reply, another transaction."""
        if not self._numbered:
            if not self._waiting:
                self.suspect()
                self._counts["foreign"] += 1
        elif packet[:2] != self._strange and not (
            self._waiting and packet[:2] == self._transaction
        ):
            self._strange = packet[:2]
            self._counts["foreign"] += 1


def _write(
    client: Client, block: Block | None, words: list[int], device: int
) -> Awaitable[ModbusPDU]:
    """Write a block, by the function that it is written by."""
    address = 0 if block is None else block.address
    if block is None or not block.single:
        return client.write_registers(address, words, device_id=device)
    if block.table == "coil":
        return client.write_coil(address, bool(words[0]), device_id=device)
    return client.write_register(address, words[0], device_id=device)
