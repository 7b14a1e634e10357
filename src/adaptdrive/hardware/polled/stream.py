"""A stream of bytes to one device and back, over TCP or a serial line."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import socket
import struct
import termios
from collections.abc import Callable

from adaptdrive.hosts import find

_CONNECT_S = 1.0
"""Longest time to connect: a gateway may be slower to accept than a drive is to answer."""

_LONGEST = 4096
"""Bytes that are kept of what nobody takes."""

_LINGER = struct.Struct("ii")
"""Linux's `struct linger`: whether it applies, and for how many seconds."""

_COUNT = struct.Struct("i")
"""Answer of the kernel to how much a connection still holds."""


class Stream(asyncio.Protocol):
    """Bytes that have come from a device, and the way to it.

    Attributes:
        received: Bytes that nobody has taken yet.
        transport: Of the connection, None without one.
        heard: Called when something has come, before it can be taken.
    """

    def __init__(self) -> None:
        self.received = b""
        self.transport: asyncio.Transport | None = None
        self.heard: Callable[[], None] = lambda: None
        self._ended = False
        self._news = asyncio.Event()

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
        self._news.clear()
        await self._news.wait()

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
        self.heard()
        self._news.set()

    def connection_lost(self, _: Exception | None) -> None:
        """Wake whoever waits: nothing comes any more."""
        self._ended = True
        self._news.set()
