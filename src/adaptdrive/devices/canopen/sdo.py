"""SDO: reading and writing the drive's object dictionary, entry by entry.

The canopen library implements the protocol. It blocks, and therefore has its own thread, while
the event loop reads the bus and writes to it.
"""

from __future__ import annotations

import asyncio
import logging
import struct
import time
from collections.abc import Callable
from typing import TypeVar

import can
from canopen import Network
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices.canopen.dictionary import Address, Entry, label
from adaptdrive.util.errors import BusError

T = TypeVar("T")

_NUMBER_BYTES = 4
"""Bytes of the longest number that a set-up reads, and of a reply in one frame."""

_SEGMENT_BYTES = 7
"""Bytes that one frame of a long answer carries."""

_LONGEST_BYTES = 1024
"""Bytes of an entry at which it counts as one without an end; names and texts have up to 100."""

logging.getLogger("canopen").addHandler(logging.NullHandler())  # what it logs is raised, too


def describe_node(bus: CanOpenBus) -> str:
    """The drive in one phrase, such as `node 5`."""
    return f"node {bus.node_id}"


class Server:
    """The drive's object dictionary, with the errors of this package."""

    def __init__(self, client: SdoClient, name: str) -> None:
        self._client = client
        self._name = name

    def refuse(self, problem: str) -> BusError:
        """Return an error of this drive."""
        return BusError(self._name, problem)

    def read(self, address: Address, size: int = _NUMBER_BYTES) -> bytes:
        """The bytes of an entry.

        Args:
            address: The entry.
            size: How many bytes it should have: a reply in one frame has up to four where its
                length is not stated, or stated as 4.

        Raises:
            BusError: The drive refuses to be read, or its answer does not end.
        """
        data = bytearray()
        try:
            with self._client.open(*address, buffering=0) as stream:
                while part := stream.read(_SEGMENT_BYTES):
                    data += part
                    if len(data) > _LONGEST_BYTES:
                        self._client.abort()
                        raise self.refuse(f"{label(address)} has over {_LONGEST_BYTES} bytes")
        except (SdoError, struct.error) as problem:
            raise self._failure("read", address, problem) from problem
        return bytes(data[:size] if len(data) <= _NUMBER_BYTES else data)

    def number(self, address: Address) -> int:
        """Return an unsigned entry, of which a drive may send more bytes than it has.

        Raises:
            BusError: The drive refuses the read, or gives more bytes than such an entry has.
        """
        data = self.read(address)
        if len(data) > _NUMBER_BYTES:
            wanted = f"a number has at most {_NUMBER_BYTES}"
            raise self.refuse(f"{label(address)} has {len(data)} bytes, {wanted}")
        return int.from_bytes(data, "little")

    def value(self, entry: Entry) -> float:
        """The raw value of an entry.

        Raises:
            BusError: The drive refuses the read, or the length differs.
        """
        try:
            return entry.decode(self.read(entry.address, entry.size))
        except ValueError as problem:
            raise self.refuse(str(problem)) from problem

    def write(self, address: Address, data: bytes) -> None:
        """Write an entry.

        Raises:
            BusError: The drive does not take it.
        """
        try:
            self._client.download(*address, data)
        except (SdoError, struct.error) as problem:
            raise self._failure("write", address, problem) from problem

    def write_surely(self, address: Address, data: bytes) -> None:
        """Write an entry and read it back.

        Raises:
            BusError: The drive does not take it, or keeps another value.
        """
        self.write(address, data)
        kept = self.read(address, len(data))
        if kept != data:
            found, wanted = kept[::-1].hex(), data[::-1].hex()
            raise self.refuse(f"{label(address)} is 0x{found} after 0x{wanted} was written")

    def settle(self, address: Address, data: bytes) -> None:
        """Write an entry that does not hold some bytes yet: one that is read-only may hold them.

        Raises:
            BusError: The drive does not take it.
        """
        if self.read(address, len(data)) != data:
            self.write(address, data)

    def offer(self, address: Address, data: bytes) -> None:
        """Write an entry that the drive need not take.

        An answer that is late is waited for: it would be taken for that to the next request.
        """
        try:
            self._client.download(*address, data)
        except SdoAbortedError:
            pass
        except (SdoError, struct.error):
            time.sleep(self._client.RESPONSE_TIMEOUT)

    def _failure(self, verb: str, address: Address, problem: Exception) -> BusError:
        if not isinstance(problem, SdoAbortedError):
            return self.refuse(f"no answer when asked to {verb} {label(address)}")
        words = str(problem).partition(", ")[2] or f"abort code 0x{problem.code:08X}"
        return self.refuse(f"cannot {verb} {label(address)}: {words[0].lower()}{words[1:]}")


class SdoLink(Network):
    """Threads that work with the drive's object dictionary, one after the other.

    It is the bus as the canopen library sees it; frames are handed over, never sent from here.
    """

    def __init__(self, bus: CanOpenBus, send: Callable[[int, bytes], object]) -> None:
        """Start no thread yet.

        Args:
            bus: `[bus]`.
            send: Puts a frame on the bus; called in the event loop.
        """
        super().__init__()
        self._send = send
        self._loop: asyncio.AbstractEventLoop | None = None
        client = SdoClient(0x600 + bus.node_id, 0x580 + bus.node_id, ObjectDictionary())
        client.RESPONSE_TIMEOUT = bus.sdo_timeout_s
        client.network = self
        self.subscribe(client.tx_cobid, client.on_response)
        self._server = Server(client, describe_node(bus))

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT002 - canopen's
        """Hand one frame over.

        Raises:
            BusError: No more work is wanted, which ends what is under way.
        """
        loop = self._loop
        if loop is None or remote:
            raise BusError("set-up", "given up")
        loop.call_soon_threadsafe(self._send, can_id, bytes(data))

    def take_reply(self, frame: can.Message) -> None:
        """Take a frame of the node's SDO server."""
        if self._loop is not None:
            self.notify(frame.arbitration_id, bytearray(frame.data), 0.0)

    async def run(self, work: Callable[[Server], T]) -> T:
        """Let a thread work; it has ended when this returns or is cancelled.

        Args:
            work: Done in the thread.

        Raises:
            BusError: The drive does not answer, or refuses.
        """
        self._loop = asyncio.get_running_loop()
        future = asyncio.ensure_future(asyncio.to_thread(work, self._server))
        try:
            return await asyncio.shield(future)
        finally:
            self._loop = None
            await asyncio.wait([future])
            if not future.cancelled():
                future.exception()  # it was raised above, or is not needed any more
