"""Connections in memory: the bytes of a network or of a serial line, without the kernel.

Both ends run in one event loop; in virtual time, what comes when is exact and the same every time.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import pytest

from adaptdrive.devices.modbus.link import SerialPort
from adaptdrive.devices.polled.link import PolledLink, Stream

_unheld = PolledLink.open, PolledLink._reply  # as before virtual time stands still during them
_served: dict[str, Callable[[], asyncio.Protocol]] = {}
_ports = itertools.count(1024)
Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[Any, Any, None]]


class End(asyncio.Transport):
    """One end of a connection.

    Attributes:
        far: The other end.
        is_dropped: Whether an end has given up what was under way.
    """

    far: End

    def __init__(self, protocol: asyncio.BaseProtocol) -> None:
        super().__init__()
        self._loop = asyncio.get_running_loop()
        self._protocol: Any = protocol
        self._ended = self.is_dropped = False

    def write(self, data: Any) -> None:
        if not self._ended:
            self._loop.call_soon(self.far.hear, bytes(data))

    def hear(self, data: bytes) -> None:
        """Take what the other end has sent."""
        if not self._ended:
            self._protocol.data_received(data)

    def close(self) -> None:
        if not self._ended:
            self._ended = True
            self._loop.call_soon(self._protocol.connection_lost, None)
            self._loop.call_soon(self.far.close)

    def abort(self) -> None:
        self.is_dropped = self.far.is_dropped = self.is_dropped or not self._ended
        self.close()

    def is_closing(self) -> bool:
        return self._ended


def serve(address: object, protocol: Callable[[], asyncio.Protocol]) -> None:
    """Let connections to a port, or to a serial device, end at protocols."""
    _served[str(address)] = protocol


def withdraw(address: object) -> None:
    """Take no more connections at an address."""
    _served.pop(str(address), None)


def new_port() -> int:
    """Return a port that nobody else serves."""
    return next(_ports)


@contextlib.contextmanager
def serving(port: int, handler: Handler) -> Iterator[None]:
    """Handle the connections to a port as a server of asyncio's streams does."""
    serve(port, lambda: asyncio.StreamReaderProtocol(asyncio.StreamReader(), handler))
    try:
        yield
    finally:
        withdraw(port)


def connect(address: object, protocol: asyncio.Protocol) -> End:
    """Connect a protocol to what is served at an address.

    Raises:
        ConnectionRefusedError: Nothing is.
    """
    if str(address) not in _served:
        raise ConnectionRefusedError("refused")
    server = _served[str(address)]()
    near, far = End(protocol), End(server)
    near.far, far.far = far, near
    server.connection_made(far)
    protocol.connection_made(near)
    return near


async def _connect(stream: Stream, _: str, port: int) -> None:
    try:
        stream.transport = connect(port, stream)
    except ConnectionRefusedError as problem:
        raise OSError(f"no connection: {problem}") from problem


async def _open(port: SerialPort, protocol: asyncio.Protocol) -> End:
    try:
        return connect(port._config.device, protocol)
    except ConnectionRefusedError as problem:
        raise OSError("there is no such serial port") from problem


@contextlib.contextmanager
def in_memory() -> Iterator[None]:
    """Let every polled link of this process end in memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stream, "connect", _connect)
        patch.setattr(SerialPort, "open", _open)
        patch.setattr(PolledLink, "open", _unheld[0])
        patch.setattr(PolledLink, "_reply", _unheld[1])
        yield
    _served.clear()
