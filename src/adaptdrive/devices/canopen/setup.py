"""Set-up of a node over SDO: identity, heartbeats, SYNC and PDO mapping.

The daemon energises no drive meanwhile. One that is still energised is commanded off first, or else
switched off by its own watch, which the set-up leaves running.
"""

from __future__ import annotations

from collections.abc import Iterator

from adaptdrive.config.bus import CanOpenBus
from adaptdrive.devices.canopen.dictionary import PRODUCT, VENDOR, Address
from adaptdrive.devices.canopen.mapping import (
    ABORT_OPTION,
    DEVICE_TYPE,
    HEARTBEAT_SENT,
    HEARTBEATS_HEARD,
    QUICK_STOP_OPTION,
    SYNC_ID,
    SYNC_PERIOD,
    CanOpenMapping,
    Channel,
    Pdo,
)
from adaptdrive.devices.canopen.profile import CONTROLWORD, DISABLE_VOLTAGE
from adaptdrive.devices.canopen.sdo import Server

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

Write = tuple[Address, bytes]


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
        if address != HEARTBEATS_HEARD or server.read(address, len(data)) != data:
            server.write_surely(address, data)
    _end_quick_stops(server, mapping)
    for address, data in sync_writes(bus, mapping, half_cycle_s):
        known = address in mapping.present or bus.sync == "drive"
        (server.settle if known else server.offer)(address, data)
    for channel in mapping.unused:
        _switch_off(server, channel)
    for status in mapping.statuses:
        _describe(server, status.pdo, _EACH_SYNC)
    for order in mapping.orders:
        _describe(server, order.pdo, _ON_ARRIVAL)
    for entry, data, reads in mapping.setup:
        write = server.write_surely if reads else server.write
        write(entry.address, data)


def watch_writes(bus: CanOpenBus, mapping: CanOpenMapping) -> Iterator[Write]:
    """Heartbeats, and what the drive does when the daemon's stop."""
    yield HEARTBEAT_SENT, _milliseconds(bus.heartbeat_s).to_bytes(2, "little")
    consumer = bus.own_node_id << 16 | _milliseconds(bus.heartbeat_timeout_s)
    yield HEARTBEATS_HEARD, consumer.to_bytes(4, "little")
    if ABORT_OPTION in mapping.present:
        yield ABORT_OPTION, _TO_DISABLE_VOLTAGE.to_bytes(2, "little")


def sync_writes(bus: CanOpenBus, mapping: CanOpenMapping, half_cycle_s: float) -> Iterator[Write]:
    """Return the writes that select the sender of SYNC and its period."""
    yield SYNC_ID, SYNC_COB_ID.to_bytes(4, "little")
    if SYNC_PERIOD in mapping.present:
        yield SYNC_PERIOD, round(1e6 * half_cycle_s).to_bytes(4, "little")
    if bus.sync == "drive":
        yield SYNC_ID, (SYNC_COB_ID | _PRODUCES_SYNC).to_bytes(4, "little")


def _identify(server: Server, bus: CanOpenBus, mapping: CanOpenMapping) -> None:
    profile = server.number(DEVICE_TYPE) & 0xFFFF
    if profile != _PROFILE:
        raise server.refuse(f"is no CiA 402 drive: its device type 0x1000 names profile {profile}")
    names = {VENDOR: "vendor", PRODUCT: "product"}
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
    if QUICK_STOP_OPTION not in mapping.present:
        return
    option = server.number(QUICK_STOP_OPTION)
    if option in _STAYING_STOPS:
        server.write_surely(QUICK_STOP_OPTION, (option - _ENDED).to_bytes(2, "little"))


def _describe(server: Server, pdo: Pdo, transmission: int) -> None:
    """Write the mapping of a PDO, which is switched off meanwhile."""
    channel = pdo.channel
    remote = _switch_off(server, channel) & _NO_REMOTE_REQUEST
    server.write((channel.communication, 2), bytes((transmission,)))
    count = channel.mapping, 0
    server.write(count, b"\0")
    for number, entry in enumerate(pdo.entries, start=1):
        mapped = entry.address[0] << 16 | entry.address[1] << 8 | entry.bits
        server.write_surely((channel.mapping, number), mapped.to_bytes(4, "little"))
    server.write_surely(count, bytes((len(pdo.entries),)))
    server.write((channel.communication, 1), (channel.cob_id | remote).to_bytes(4, "little"))


def _switch_off(server: Server, channel: Channel) -> int:
    """Make a PDO invalid; its frame id as it was."""
    address = channel.communication, 1
    cob_id = server.number(address)
    if not cob_id & _INVALID:
        server.write(address, (cob_id | _INVALID).to_bytes(4, "little"))
    return cob_id


def _milliseconds(time_s: float) -> int:
    return max(1, round(1e3 * time_s))
