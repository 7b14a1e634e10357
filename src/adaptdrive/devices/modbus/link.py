"""One exchange at a time with one Modbus device, on TCP or on a serial port.

Linux waits inside both calls: for a USB adapter that hangs, and on closing for as much as 30 s
until what was written has left. The ticks of every drive would stand still meanwhile.

A reply that does not belong to its request must never be taken for it. On TCP the transaction id
shows it. On a serial line nothing does: a reply that comes after its time-out would answer the next
request, and every request from then on would be given the reply before. So after a reply has
failed, or after bytes without a request, the line must have been silent for a while before
anything is read again.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import termios
from collections import Counter
from collections.abc import Callable
from typing import Any

from pymodbus.transport.serialtransport import SerialTransport
from serial import SerialException

from adaptdrive.config.polled import ModbusLink, RtuLink, TcpLink
from adaptdrive.devices.modbus import frames
from adaptdrive.devices.polled.link import ExchangeError, PolledLink, Void, never
from adaptdrive.devices.polled.registers import RTU_FRAME, Exchange, silence_s
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.clock import in_thread

# A serial port whose opening and closing do not hold up the event loop.

PATIENCE_S = 5.0
"""Longest wait for a call. An adapter without a wire takes seconds to find its other half."""

_BYTE_BITS = 8


class SerialPort:
    """Opens the serial port of one link, again and again; at most one call is under way.

    A call that has not returned in time continues, and the next attempt waits for the same call.
    """

    def __init__(self, config: RtuLink) -> None:
        """Open nothing yet.

        Args:
            config: Which link.
        """
        self._config = config
        self._call: asyncio.Future[_Transport | None] | None = None
        self._purpose = ""

    async def open(self, protocol: asyncio.BaseProtocol) -> SerialTransport:
        """Open the port, and connect it to a protocol.

        Args:
            protocol: Takes what the port receives.

        Raises:
            OSError: The port cannot be opened, or not in time.
            ValueError: It does not take a setting.
        """
        transport = None
        try:
            while transport is None:  # a closing under way gives none
                transport = await self._returned()
        except SerialException as problem:
            why = "the serial port cannot be opened: no permission, or another process uses it"
            gone = "there is no such serial port"
            raise OSError(why if self._config.device.exists() else gone) from problem
        except termios.error as problem:
            refused = f"the serial port does not take these settings: {problem.args[-1]}"
            raise OSError(refused) from problem
        transport.set_protocol(protocol)
        transport.setup()
        return transport

    async def _returned(self) -> _Transport | None:
        """Await the call under way, or a new opening.

        Raises:
            TimeoutError: It did not return in time.
        """
        if self._call is None:
            loop, one = asyncio.get_running_loop(), self._config
            settings = (one.baud, _BYTE_BITS, one.parity, one.stop_bits, 0.0)
            given = (self._let_close, loop, None, str(one.device), *settings)
            self._call, self._purpose = _begun(lambda: _Transport(*given)), "opened"
        call = self._call
        returned, _ = await asyncio.wait([call], timeout=PATIENCE_S)
        if not returned:
            problem = f"not {self._purpose} within {PATIENCE_S:g} s"
            raise TimeoutError(f"the serial port hangs: {problem}")
        self._call = None
        return call.result()

    def _let_close(self, port: Any) -> None:  # noqa: ANN401 - pyserial has no types
        """Close an open port of pyserial, without waiting for it."""

        def close() -> None:
            with contextlib.suppress(OSError):  # of a port that is gone
                port.close()

        self._call, self._purpose = _begun(close), "closed"


class _Transport(SerialTransport):
    """pymodbus's transport of a serial port, which leaves the closing to the port's owner."""

    def __init__(self, let_close: Callable[[Any], None], *args: Any) -> None:  # noqa: ANN401
        super().__init__(*args)
        self._let_close = let_close

    def close(self, exc: Exception | None = None) -> None:
        """Take nothing from the port any more, and let it be closed."""
        port = self.sync_serial
        if not port:
            return
        self.flush()
        self.async_loop.remove_reader(port.fileno())
        self.sync_serial = None
        self._let_close(port)
        if exc is not None:
            self.intern_protocol.connection_lost(exc)


def _begun(call: Callable[[], _Transport | None]) -> asyncio.Future[_Transport | None]:
    return asyncio.wrap_future(in_thread(call, "serial port"))


# One exchange at a time with one device, and what can go wrong with it.

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


class ModbusConnection(PolledLink):
    """An open link to one device, or to several that share it."""

    def __init__(
        self,
        config: TcpLink | RtuLink,
        counts: Counter[str],
        clock: Callable[[], float],
        sharers: int = 1,
        *,
        serial: SerialPort | None = None,
    ) -> None:
        """Prepare a link; nothing is opened yet.

        Args:
            config: Which link.
            counts: What is counted on it.
            clock: Monotonic clock in seconds.
            sharers: Requests in turn of which another one may be answered: a link to several
                devices is kept while one of them answers.
            serial: Port of a serial link, kept by whoever opens the link again.
        """
        super().__init__(describe_bus(config), config.timeout_s, counts, clock)
        self._config = config
        self._serial_port = serial
        self._patience = max(_PATIENCE, sharers)
        self._numbered = config.numbered
        self._frames = frames.TcpFrames() if config.numbered else frames.SerialFrames()
        self._stream.unasked = self._note_unasked
        self._settled_s = -math.inf
        self._missed = 0
        self._replied_s = clock()
        self.suspect()

    @property
    def miss_s(self) -> float:
        """Time for which a missing reply keeps the link busy."""
        return miss_s(self._config)

    async def _connect(self) -> None:
        config, stream = self._config, self._stream
        if isinstance(config, TcpLink):
            await stream.connect(config.host, config.port)
        else:
            port = self._serial_port or SerialPort(config)
            stream.transport = await port.open(stream)

    async def exchange(
        self, exchange: Exchange, words: list[int], void: Void | None = never
    ) -> list[int]:
        """Ask for registers, or write some, or both, as every polled link does."""
        if void is not None:
            await self._await_silence(void)
        hasty = self.unsettled_s() > 0.0
        self._begin(void)
        asked = frames.request(exchange, words)
        reply = await self._reply_to(asked, exchange)
        await asyncio.sleep(silence_s(self._config))
        registers = self._checked(reply, asked, exchange)
        if hasty:
            self.suspect()
            late = ExchangeError("a reply that may be one to an earlier request")
            late.doubtful = True
            raise late
        return registers

    async def _reply_to(self, asked: bytes, exchange: Exchange) -> bytes:
        """Return the reply to a request, without what frames it.

        Raises:
            ExchangeError: There is none.
        """
        device = self._config.device_id if exchange.device_id is None else exchange.device_id
        reply = await self._reply(self._frames.framed(asked, device), self._frames.reply)
        self._counts["foreign"] += self._frames.foreign
        if reply is not None:
            return reply
        self._miss(exchange)
        received = self._stream.received
        instead = f"; {self._frames.explain(received)}" if received else f" to {exchange}"
        problem = f"no reply within {self._timeout_s:g} s{instead}"
        raise ExchangeError(problem, kind=TripKind.NO_REPLY)

    def _miss(self, exchange: Exchange) -> None:
        """Count a missing reply, and what came in its place."""
        self.suspect()
        self._missed += 1
        received = len(self._stream.received)
        if self.lost is not None:
            return
        if not self._numbered and received:
            short = received < exchange.reply_bytes + RTU_FRAME
            self._counts["wrong_length" if short else "wrong_checksum"] += 1
        elif isinstance(self._config, TcpLink) and self._missed >= self._patience:
            stuck = self._stream.undelivered_bytes > 0
            patience_s = _PATIENCE_S if self._answered else _FIRST_S
            if stuck or self._clock() - self._replied_s >= patience_s:
                self.lost = f"no reply to {self._missed} requests in a row"

    def _checked(self, reply: bytes, asked: bytes, exchange: Exchange) -> list[int]:
        """Return the registers of a reply.

        Raises:
            ExchangeError: It is an exception reply, or one to another request.
        """
        self._missed, self._replied_s = 0, self._clock()
        code = frames.exception_code(reply)
        if code is not None:
            self._counts["exceptions"] += 1
            kind, problem = frames.explain_exception(code, exchange)
            raise ExchangeError(problem, code, kind=kind)
        registers = frames.answer(reply, asked, exchange)
        if registers is None:
            self.suspect()
            self._counts["foreign"] += 1
            raise ExchangeError("a reply that belongs to another request")
        self._counts["received"] += 1
        return registers

    async def _await_silence(self, void: Void) -> None:
        """Let what may still come from an earlier request pass by unread, while it is wanted.

        Raises:
            ExchangeError: The line is never silent.
        """
        end_s = self._clock() + _NOISE_ROUNDS * _SILENT_TIMEOUTS * self._timeout_s
        while (left_s := self.unsettled_s()) > 0.0 and not void():
            if self._clock() > end_s:
                raise ExchangeError("the line is never silent")
            await asyncio.sleep(min(left_s, _LOOK_S))

    def unsettled_s(self) -> float:
        """Return how much longer a serial line must be silent before a reply is its request's."""
        return max(0.0, self._settled_s - self._clock())

    def suspect(self) -> None:
        """Take what comes next on a serial line for what is left of something else."""
        if not self._numbered:
            self._settled_s = self._clock() + _SILENT_TIMEOUTS * self._timeout_s

    def _note_unasked(self) -> None:
        """Count what no request waits for: noise, a late reply, another transaction."""
        self.suspect()
        self._counts["foreign"] += 1


def miss_s(config: ModbusLink) -> float:
    """Return the time in s for which a missing reply keeps a link busy.

    Args:
        config: The link.
    """
    return (1.0 if config.numbered else 1.0 + _SILENT_TIMEOUTS) * config.timeout_s


def describe_bus(config: TcpLink | RtuLink) -> str:
    """The link in one phrase, such as `modbus-rtu /dev/ttyUSB0 9600 8E1 device 1`."""
    if isinstance(config, TcpLink):
        return f"modbus-tcp {config.host}:{config.port} device {config.device_id}"
    return f"modbus-rtu {config.device} {config.baud} {config.form} device {config.device_id}"
