"""A serial port whose opening and closing do not hold up the event loop.

Linux waits inside both calls: for a USB adapter that hangs, and on closing for as much as 30 s
until what was written has left. The ticks of every drive would stand still meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import termios
from collections.abc import Callable
from typing import Any

from pymodbus.transport.serialtransport import SerialTransport
from serial import SerialException

from adaptdrive.aside import in_thread
from adaptdrive.config.modbus import RtuLink

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
            settings = (one.baud, _BYTE_BITS, one.parity[0].upper(), one.stop_bits, 0.0)
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
