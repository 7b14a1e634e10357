"""A serial port whose opening and closing do not hold up the event loop.

Linux waits inside both calls: for a USB adapter that hangs, and on closing for as much as 30 s
until what was written has left. The ticks of every drive would stand still meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import termios
from collections.abc import Awaitable
from concurrent.futures import Future
from typing import Any, TypeVar

from pymodbus.transport.serialtransport import SerialTransport
from serial import SerialException

from adaptdrive.aside import in_thread
from adaptdrive.config.modbus import RtuLink

PATIENCE_S = 5.0
"""Longest wait for a call. An adapter without a wire takes seconds to find its other half."""

_BYTE_BITS = 8

Result = TypeVar("Result")


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
        self._opening: Future[SerialTransport] | None = None
        self._closing: Future[None] | None = None

    async def open(
        self, protocol: asyncio.BaseProtocol
    ) -> tuple[SerialTransport, asyncio.BaseProtocol]:
        """Open the port, and connect it to a protocol.

        Args:
            protocol: Takes what the port receives.

        Raises:
            OSError: The port cannot be opened, or not in time.
            ValueError: It does not take a setting.
        """
        try:
            transport = await self._transport(protocol)
        except termios.error as problem:
            refused = f"the serial port does not take these settings: {problem.args[-1]}"
            raise OSError(refused) from problem
        transport.set_protocol(protocol)  # of this attempt, should the call be of an earlier one
        asyncio.get_running_loop().call_soon(transport.setup)
        return transport, protocol

    async def _transport(self, protocol: asyncio.BaseProtocol) -> SerialTransport:
        """Await the call under way, or a new one."""
        loop = asyncio.get_running_loop()
        if self._closing is not None:
            await _in_time(asyncio.wrap_future(self._closing), "closed")
            self._closing = None
        if self._opening is None:
            self._opening = in_thread(lambda: self._opened(loop, protocol), "serial port")
        opening = self._opening
        try:
            transport = await _in_time(asyncio.wrap_future(opening), "opened")
        except SerialException as problem:
            why = "the serial port cannot be opened: no permission, or another process uses it"
            gone = "there is no such serial port"
            raise OSError(why if self._config.device.exists() else gone) from problem
        finally:
            if opening.done() and opening.exception() is not None:
                self._opening = None
        self._opening = None
        return transport

    def _opened(
        self, loop: asyncio.AbstractEventLoop, protocol: asyncio.BaseProtocol
    ) -> _Transport:
        one = self._config
        settings = (one.baud, _BYTE_BITS, one.parity[0].upper(), one.stop_bits, 0.0)
        return _Transport(self, loop, protocol, str(one.device), *settings)

    def close(self, port: Any) -> None:  # noqa: ANN401 - pyserial has no types
        """Close an open port of pyserial, without waiting for it."""

        def close() -> None:
            with contextlib.suppress(OSError):  # of a port that is gone
                port.close()

        self._closing = in_thread(close, "serial port")


class _Transport(SerialTransport):
    """pymodbus's transport of a serial port, which leaves the closing to the port's owner."""

    def __init__(self, owner: SerialPort, *args: Any) -> None:  # noqa: ANN401 - pymodbus's own
        super().__init__(*args)
        self._owner = owner

    def setup(self) -> None:
        """Begin to receive, unless the port was closed meanwhile."""
        if self.sync_serial:
            super().setup()

    def close(self, exc: Exception | None = None) -> None:
        """Take nothing from the port any more, and let it be closed."""
        port = self.sync_serial
        if not port:
            return
        self.flush()
        self.async_loop.remove_reader(port.fileno())
        self.sync_serial = None
        self._owner.close(port)
        if exc is not None:
            self.intern_protocol.connection_lost(exc)


async def _in_time(call: Awaitable[Result], done: str) -> Result:
    """Await a call.

    Raises:
        TimeoutError: It did not return in time.
    """
    try:
        async with asyncio.timeout(PATIENCE_S):
            return await call
    except TimeoutError as problem:
        raise TimeoutError(
            f"the serial port hangs: not {done} within {PATIENCE_S:g} s"
        ) from problem
