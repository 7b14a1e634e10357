"""SDO: entries of the object dictionary read and written, and the set-up of a node.

The canopen library implements the protocol. It blocks, and therefore has its own thread, while
the event loop reads the bus and writes to it.

The daemon energises no drive meanwhile. One that is still energised is commanded off first, or else
switched off by its own watch, which the set-up leaves running.
"""

import asyncio
import logging
import struct
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

import can
from canopen import Network
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices.canopen import dictionary
from adaptdrive.devices.canopen.dictionary import label
from adaptdrive.devices.canopen.mapping import CanOpenMapping, Pdo
from adaptdrive.devices.canopen.profile import CONTROLWORD, DISABLE_VOLTAGE
from adaptdrive.util.errors import BusError

# SDO: reading and writing the drive's object dictionary, entry by entry.

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

    def read(self, address: dictionary.Address, size: int = _NUMBER_BYTES) -> bytes:
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

    def number(self, address: dictionary.Address) -> int:
        """Return an unsigned entry, of which a drive may send more bytes than it has.

        Raises:
            BusError: The drive refuses the read, or gives more bytes than such an entry has.
        """
        data = self.read(address)
        if len(data) > _NUMBER_BYTES:
            wanted = f"a number has at most {_NUMBER_BYTES}"
            raise self.refuse(f"{label(address)} has {len(data)} bytes, {wanted}")
        return int.from_bytes(data, "little")

    def value(self, entry: dictionary.Entry) -> float:
        """The raw value of an entry.

        Raises:
            BusError: The drive refuses the read, or the length differs.
        """
        try:
            return entry.decode(self.read(entry.address, entry.size))
        except ValueError as problem:
            raise self.refuse(str(problem)) from problem

    def write(self, address: dictionary.Address, data: bytes) -> None:
        """Write an entry.

        Raises:
            BusError: The drive does not take it.
        """
        try:
            self._client.download(*address, data)
        except (SdoError, struct.error) as problem:
            raise self._failure("write", address, problem) from problem

    def write_surely(self, address: dictionary.Address, data: bytes) -> None:
        """Write an entry and read it back.

        Raises:
            BusError: The drive does not take it, or keeps another value.
        """
        self.write(address, data)
        kept = self.read(address, len(data))
        if kept != data:
            found, wanted = kept[::-1].hex(), data[::-1].hex()
            raise self.refuse(f"{label(address)} is 0x{found} after 0x{wanted} was written")

    def settle(self, address: dictionary.Address, data: bytes) -> None:
        """Write an entry that does not hold some bytes yet: one that is read-only may hold them.

        Raises:
            BusError: The drive does not take it.
        """
        if self.read(address, len(data)) != data:
            self.write(address, data)

    def offer(self, address: dictionary.Address, data: bytes) -> None:
        """Write an entry that the drive need not take.

        An answer that is late is waited for: it would be taken for that to the next request.
        """
        try:
            self._client.download(*address, data)
        except SdoAbortedError:
            pass
        except (SdoError, struct.error):
            time.sleep(self._client.RESPONSE_TIMEOUT)

    def _failure(self, verb: str, address: dictionary.Address, problem: Exception) -> BusError:
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


# Set-up of a node over SDO: identity, heartbeats, SYNC and PDO mapping.

SYNC_COB_ID = 0x080

_PROFILE = 402
_TO_DISABLE_VOLTAGE = 2
_STAYING_STOPS = range(5, 9)
_ENDED = 4
"""Options of a quick stop that ends in *switch on disabled* are those of one that stays, less 4."""

_PRODUCES_SYNC = 1 << 30
_INVALID = 1 << 31
_NO_REMOTE_REQUEST = 1 << 30
_EACH_SYNC = 1
_ON_ARRIVAL = 255

Write = tuple[dictionary.Address, bytes]


def set_up(server: Server, bus: CanOpenBus, mapping: CanOpenMapping, half_cycle_s: float) -> None:
    """Write the parameters of the drive, and read back those that safety depends on.

    Args:
        server: The drive, in state pre-operational.
        bus: `[bus]`.
        mapping: What its PDOs shall carry.
        half_cycle_s: Half a line cycle.

    Raises:
        BusError: The drive does not answer, refuses, or is not the one that the EDS describes.
    """
    _identify(server, bus, mapping)
    # its state may have stayed, without the watch, and it may refuse its PDOs while it is on; one
    # that takes no controlword here is left to what it does by itself
    server.offer(CONTROLWORD, DISABLE_VOLTAGE.to_bytes(2, "little"))
    for address, data in watch_writes(bus, mapping):
        # a consumer that is written anew waits for a first heartbeat: its time-out would not end
        if address != dictionary.HEARTBEATS_HEARD or server.read(address, len(data)) != data:
            server.write_surely(address, data)
    _end_quick_stops(server, mapping)
    for address, data in sync_writes(bus, mapping, half_cycle_s):
        known = address in mapping.present or bus.sync == "drive"
        (server.settle if known else server.offer)(address, data)
    for pdo in mapping.unused:
        _switch_off(server, pdo)
    for pdo in mapping.sent:
        _describe(server, pdo, _EACH_SYNC)
    for pdo in mapping.taken:
        _describe(server, pdo, _ON_ARRIVAL)
    for entry, data, reads in mapping.setup:
        write = server.write_surely if reads else server.write
        write(entry.address, data)


def watch_writes(bus: CanOpenBus, mapping: CanOpenMapping) -> Iterator[Write]:
    """Heartbeats, and what the drive does when the daemon's stop."""
    yield dictionary.HEARTBEAT_SENT, _milliseconds(bus.heartbeat_s).to_bytes(2, "little")
    consumer = bus.own_node_id << 16 | _milliseconds(bus.heartbeat_timeout_s)
    yield dictionary.HEARTBEATS_HEARD, consumer.to_bytes(4, "little")
    if dictionary.ABORT_OPTION in mapping.present:
        yield dictionary.ABORT_OPTION, _TO_DISABLE_VOLTAGE.to_bytes(2, "little")


def sync_writes(bus: CanOpenBus, mapping: CanOpenMapping, half_cycle_s: float) -> Iterator[Write]:
    """Return the writes that select the sender of SYNC and its period."""
    yield dictionary.SYNC_ID, SYNC_COB_ID.to_bytes(4, "little")
    if dictionary.SYNC_PERIOD in mapping.present:
        yield dictionary.SYNC_PERIOD, round(1e6 * half_cycle_s).to_bytes(4, "little")
    if bus.sync == "drive":
        yield dictionary.SYNC_ID, (SYNC_COB_ID | _PRODUCES_SYNC).to_bytes(4, "little")


def _identify(server: Server, bus: CanOpenBus, mapping: CanOpenMapping) -> None:
    profile = server.number(dictionary.DEVICE_TYPE) & 0xFFFF
    if profile != _PROFILE:
        raise server.refuse(f"is no CiA 402 drive: its device type 0x1000 names profile {profile}")
    names = {dictionary.VENDOR: "vendor", dictionary.PRODUCT: "product"}
    for address, expected in mapping.identity:
        found = server.number(address)
        if found != expected:
            raise server.refuse(
                f"is not the drive of {bus.eds.name}: its {names[address]} is 0x{found:08X}, "
                f"the EDS is for 0x{expected:08X}"
            )


def _end_quick_stops(server: Server, mapping: CanOpenMapping) -> None:
    """Let a quick stop end in *switch on disabled*, after the same ramp.

    One that stays is ended by the next command to enable operation, before anybody has seen it.
    """
    if dictionary.QUICK_STOP_OPTION not in mapping.present:
        return
    option = server.number(dictionary.QUICK_STOP_OPTION)
    if option in _STAYING_STOPS:
        server.write_surely(dictionary.QUICK_STOP_OPTION, (option - _ENDED).to_bytes(2, "little"))


def _describe(server: Server, pdo: Pdo, transmission: int) -> None:
    """Write the mapping of a PDO, which is switched off meanwhile."""
    remote = _switch_off(server, pdo) & _NO_REMOTE_REQUEST
    server.write((pdo.communication, 2), bytes((transmission,)))
    count = pdo.mapping, 0
    server.write(count, b"\0")
    for number, entry in enumerate(pdo.entries, start=1):
        mapped = entry.address[0] << 16 | entry.address[1] << 8 | entry.bits
        server.write_surely((pdo.mapping, number), mapped.to_bytes(4, "little"))
    server.write_surely(count, bytes((len(pdo.entries),)))
    server.write((pdo.communication, 1), (pdo.cob_id | remote).to_bytes(4, "little"))


def _switch_off(server: Server, pdo: Pdo) -> int:
    """Make a PDO invalid; its frame id as it was."""
    address = pdo.communication, 1
    cob_id = server.number(address)
    if not cob_id & _INVALID:
        server.write(address, (cob_id | _INVALID).to_bytes(4, "little"))
    return cob_id


def _milliseconds(time_s: float) -> int:
    return max(1, round(1e3 * time_s))
