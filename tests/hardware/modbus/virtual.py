"""A Modbus port in virtual time, on a wire in memory: thousands of polls in a second, no stall.

Time passes only while every task waits, so what a test counts is the same on any machine.
"""

from __future__ import annotations

import asyncio
import selectors
import struct
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import pytest

from adaptdrive.hardware.modbus import port, sensors
from adaptdrive.hardware.polled import link
from adaptdrive.hardware.port import Reading
from tests.hardware.bench import Ear
from tests.hardware.modbus.bench import Peer, framed

_TURNAROUND_s = 0.002
_PIECE_s = 0.0001

_TCP_SHORTEST = 12
"""Bytes of the shortest request on TCP, four more than of the same one on a serial line."""


class _Selector(selectors.SelectSelector):
    """Passes the time that it is asked to wait."""

    now_s = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        assert timeout is not None, "every task waits, and for nothing"
        self.now_s += max(0.0, timeout)
        return super().select(0.0)


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is virtual, and whose connections all end at one drive."""

    def __init__(self, drive: VirtualDrive) -> None:
        self._virtual = _Selector()
        super().__init__(self._virtual)
        self._drive = drive

    def time(self) -> float:
        return self._virtual.now_s

    def stand_still(self, seconds: float) -> None:
        """Let time pass in which nothing of this process runs."""
        self._virtual.now_s += seconds

    async def create_connection(  # type: ignore[override]
        self, factory: Callable[[], asyncio.Protocol], *_: object, **__: object
    ) -> tuple[asyncio.Transport, asyncio.Protocol]:
        return self.joined(factory())

    def joined(self, protocol: asyncio.Protocol) -> tuple[asyncio.Transport, asyncio.Protocol]:
        """Connect a protocol to the drive."""
        wire = _Wire(self, self._drive, protocol)
        self.call_soon(protocol.connection_made, wire)
        return wire, protocol

    def serve(self, port: Coroutine[Any, Any, None], enough: Callable[[], bool]) -> None:
        """Run a port until there is enough, which is looked at every second; close the loop."""

        async def run() -> None:
            serving = self.create_task(port)
            while not enough():  # noqa: ASYNC110 - virtual time
                await asyncio.sleep(1.0)
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)

        try:
            self.run_until_complete(run())
        finally:
            self.close()


class _Wire(asyncio.Transport):
    """The port's end of the wire."""

    def __init__(self, loop: VirtualLoop, drive: VirtualDrive, protocol: asyncio.Protocol) -> None:
        super().__init__()
        self._loop, self._drive, self._protocol = loop, drive, protocol

    def write(self, data: Any) -> None:
        for number, piece in enumerate(self._drive.echo(bytes(data)), 1):
            self._loop.call_later(number * _PIECE_s, self._protocol.data_received, piece)
        reply = self._drive.hear(bytes(data))
        for delay_s in self._drive.copies(reply):
            self._loop.call_later(_TURNAROUND_s + delay_s, self._protocol.data_received, reply)

    def close(self) -> None:
        """End the connection."""

    abort = close

    def is_closing(self) -> bool:
        return False


def is_serial(request: bytes) -> bool:
    """Return whether a request is framed for a serial line.

    One of 65536 requests on TCP ends with its own checksum by chance; its header gives its length.
    """
    tcp = struct.pack(">HH", 0, len(request) - 6) == request[2:6] and len(request) >= _TCP_SHORTEST
    return not tcp and framed(request[:-2]) == request


class VirtualSerialPort:
    """Stands for the serial port of a link."""

    def __init__(self, _: object) -> None:
        """Take any link."""

    async def open(self, protocol: asyncio.Protocol) -> asyncio.Transport:
        """Connect a protocol to the drive."""
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        return loop.joined(protocol)[0]


class VirtualDrive:
    """A drive whose replies a test may lose or repeat, and which counts how long it is not fed.

    Attributes:
        peer: Its registers.
        copies: Returns the delay of each copy of a reply, in s; none of one that is lost.
        echo: Returns the pieces in which the port hears its own request.
        unfed: Requests that read, since the last command that was taken.
        longest: The highest of those counts.
    """

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.copies: Callable[[bytes], Sequence[float]] = lambda _: (0.0,)
        self.echo: Callable[[bytes], Sequence[bytes]] = lambda _: ()
        self.unfed = self.longest = 0

    def hear(self, frame: bytes) -> bytes:
        """Take a request; return its reply."""
        serial = is_serial(frame)
        pdu = self.peer.reply(frame[1:-2] if serial else frame[7:])
        self.unfed = 0 if pdu[0] in {16, 23} else self.unfed + 1
        self.longest = max(self.longest, self.unfed)
        if serial:
            return framed(frame[:1] + pdu)
        return frame[:2] + struct.pack(">HH", 0, len(pdu) + 1) + frame[6:7] + pdu


class Follower(Ear):
    """An ear that calls back for each reading, as the fast loop decides on each."""

    def __init__(self, decide: Callable[[Reading], None]) -> None:
        super().__init__()
        self._decide = decide

    def on_reading(self, reading: Reading) -> None:
        super().on_reading(reading)
        self._decide(reading)


async def _found(host: str, *_: object) -> tuple[str, ...]:
    return (host,)


def use_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no name server and no serial port be asked."""
    monkeypatch.setattr(link, "find", _found)
    monkeypatch.setattr(port, "SerialPort", VirtualSerialPort)
    monkeypatch.setattr(sensors, "SerialPort", VirtualSerialPort)
