"""Mapping of objects to quantities: checks the configuration against its EDS.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.config.bus import Signals
from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.binding import Sink, Source, fault_words
from adaptdrive.hardware.canopen.dictionary import Address, Entry, ObjectCatalogue, label, read_eds
from adaptdrive.hardware.canopen.pdo import (
    Channel,
    Pdo,
    codec,
    pack,
    receive_channel,
    transmit_channel,
)
from adaptdrive.hardware.canopen.profile import (
    CONTROLWORD,
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    FAULT_RESET,
    SHUTDOWN,
    STATUSWORD,
    SWITCH_ON,
)
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.fault_latch import FaultWord
from adaptdrive.hardware.link.bus import channel_flaws
from adaptdrive.hardware.link.codec import MessageCodec

DEVICE_TYPE = (0x1000, 0)
SYNC_ID = (0x1005, 0)
SYNC_PERIOD = (0x1006, 0)
HEARTBEATS_HEARD = (0x1016, 1)
HEARTBEAT_SENT = (0x1017, 0)
ABORT_OPTION = (0x6007, 0)
QUICK_STOP_OPTION = (0x605A, 0)

_OPTIONAL = (SYNC_PERIOD, ABORT_OPTION, QUICK_STOP_OPTION)
_CHANNELS = 4  # CiA 301 preconfigures the identifiers of four PDOs in each direction
_NEEDED = {
    SYNC_ID: "its measurements could not be synchronised",
    HEARTBEATS_HEARD: "it could not monitor the daemon's heartbeat",
    HEARTBEAT_SENT: "its heartbeat could not be monitored",
    CONTROLWORD: "it is no CiA 402 drive",
    STATUSWORD: "it is no CiA 402 drive",
}
_CONTROLWORDS = (DISABLE_VOLTAGE, SHUTDOWN, SWITCH_ON, ENABLE_OPERATION, FAULT_RESET)
_WORD_BITS = 16
_OURS = frozenset({SYNC_ID[0], SYNC_PERIOD[0], HEARTBEATS_HEARD[0], HEARTBEAT_SENT[0]})
_FIRST_PDO, _BEHIND_PDOS = 0x1400, 0x1C00


@dataclass(frozen=True, slots=True)
class StatusPdo:
    """A PDO that carries measurements, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[Source[Entry], ...]


@dataclass(frozen=True, slots=True)
class CommandPdo:
    """A PDO that carries the command, its controlword or both."""

    codec: MessageCodec
    sinks: tuple[Sink[Entry], ...]
    controlword: bool


@dataclass(frozen=True, slots=True)
class CanOpenMapping:
    """Objects and properties of one drive, for its port.

    Attributes:
        transmits: PDOs that the drive sends.
        receives: PDOs that the drive takes.
        unused: PDOs of the drive that are switched off.
        statuses: How to read what it sends.
        orders: How to write what it takes.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
        setup: Entries that the configuration writes, their bytes, whether they read as written.
        present: Optional entries that the drive has.
        identity: Identity object that the drive must have to be the one of the EDS.
        cautions: What can be used, and is probably not meant.
        faults: Fault words of the drive.
    """

    transmits: tuple[Pdo, ...]
    receives: tuple[Pdo, ...]
    unused: tuple[Channel, ...]
    statuses: tuple[StatusPdo, ...]
    orders: tuple[CommandPdo, ...]
    counter_modulus: int | None
    setup: tuple[tuple[Entry, bytes, bool], ...]
    present: frozenset[Address]
    identity: tuple[tuple[Address, int], ...]
    cautions: tuple[Flaw, ...]
    faults: Mapping[str, FaultWord]

    @property
    def sources(self) -> tuple[Source[Entry], ...]:
        """Every quantity that is measured."""
        return tuple(source for status in self.statuses for source in status.sources)


def map_drive(
    bus: CanOpenBus,
    signals: Signals,
    source: Path | str = "configuration",
    demands: Demands = NO_DEMANDS,
) -> CanOpenMapping:
    """Find every configured object in the EDS and plan the PDOs.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
        source: The configuration, for the error message.
        demands: What the objects must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = ObjectCatalogue(*read_eds(bus.eds, bus.node_id, source))
    catalogue.flaws.extend(channel_flaws(bus))
    sources = catalogue.sources(signals.entries(), demands)
    plan = _Plan(catalogue, bus, signals, sources, catalogue.sinks(signals.command, demands))
    mapping = plan.mapping()
    if mapping is None or catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return mapping


class _Plan:
    """Collects the requested objects, and the errors in them."""

    def __init__(
        self,
        catalogue: ObjectCatalogue,
        bus: CanOpenBus,
        signals: Signals,
        sources: list[Source[Entry]],
        sinks: list[Sink[Entry]],
    ) -> None:
        self._catalogue = catalogue
        self._bus = bus
        self._signals = signals
        self._sources = sources
        self._sinks = sinks
        for address, consequence in _NEEDED.items():
            if catalogue.at(address) is None:
                missing = f"the EDS has no object {label(address)}: {consequence}"
                missing += catalogue.remark(label(address))
                catalogue.note("bus.eds", missing)
        self._check_controlword(catalogue.at(CONTROLWORD))

    def mapping(self) -> CanOpenMapping | None:
        """Return the mapping; None when errors were found."""
        transmitted = [self._catalogue.at(STATUSWORD), *(source.item for source in self._sources)]
        received = [self._catalogue.at(CONTROLWORD), *(sink.item for sink in self._sinks)]
        transmits = self._pack("TPDO", transmitted, self._channels(transmit_channel))
        receives = self._pack("RPDO", received, self._channels(receive_channel))
        setup = self._setup()
        if self._catalogue.flaws:
            return None
        return CanOpenMapping(
            transmits=transmits,
            receives=receives,
            unused=self._unused((*transmits, *receives)),
            statuses=tuple(self._status(pdo) for pdo in transmits),
            orders=tuple(self._order(pdo) for pdo in receives),
            counter_modulus=self._modulus(),
            setup=setup,
            present=frozenset(one for one in _OPTIONAL if self._catalogue.at(one)),
            identity=self._catalogue.identity,
            cautions=tuple(self._catalogue.cautions),
            faults=fault_words(self._sources, self._signals),
        )

    def _check_controlword(self, entry: Entry | None) -> None:
        """Refuse a controlword whose type or limits in the EDS keep a command from being sent."""
        if entry is None:
            return
        low, high = entry.limits
        refused = [f"0x{word:02X}" for word in _CONTROLWORDS if not low <= word <= high]
        if refused or entry.real or entry.bits != _WORD_BITS:
            has = f"{entry.bits} bits from {low:g} to {high:g}"
            needs = f"{_WORD_BITS} bits with 0x00, 0x06, 0x07, 0x0F and 0x80"
            self._catalogue.note("bus.eds", f"{label(CONTROLWORD)} has {has}, it needs {needs}")

    def _channels(self, make: Callable[[int, int], Channel]) -> list[Channel]:
        channels = [make(number, self._bus.node_id) for number in range(1, _CHANNELS + 1)]
        has = self._catalogue.has
        return [one for one in channels if has(one.communication) and has(one.mapping)]

    def _pack(
        self, name: str, entries: list[Entry | None], channels: list[Channel]
    ) -> tuple[Pdo, ...]:
        wanted = list(dict.fromkeys(entry for entry in entries if entry is not None))
        pdos = pack(name, channels, wanted)
        if pdos is None:
            bits = sum(entry.bits for entry in wanted)
            problem = f"{bits} bits do not fit into the drive's {len(channels)} {name}s"
            self._catalogue.note("signals", problem)
            return ()
        for pdo in pdos:
            count = self._catalogue.at((pdo.channel.mapping, 0))
            if count is None or not count.writable:
                self._catalogue.note("bus.eds", f"the mapping of {pdo.name} cannot be changed")
        return tuple(pdos)

    def _unused(self, used: tuple[Pdo, ...]) -> tuple[Channel, ...]:
        taken = {pdo.channel for pdo in used}
        channels = [*self._channels(transmit_channel), *self._channels(receive_channel)]
        return tuple(channel for channel in channels if channel not in taken)

    def _status(self, pdo: Pdo) -> StatusPdo:
        sources = tuple(source for source in self._sources if source.item in pdo.entries)
        return StatusPdo(codec(pdo), sources)

    def _order(self, pdo: Pdo) -> CommandPdo:
        sinks = tuple(sink for sink in self._sinks if sink.item in pdo.entries)
        controlword = any(entry.address == CONTROLWORD for entry in pdo.entries)
        return CommandPdo(codec(pdo), sinks, controlword)

    def _modulus(self) -> int | None:
        counters = (one for one in self._sources if one.quantity == "counter")
        return next((int(one.field.high) + 1 for one in counters), None)

    def _setup(self) -> tuple[tuple[Entry, bytes, bool], ...]:
        found = []
        for reference, given in self._bus.setup.items():
            place = f"bus.setup.{reference}"
            entry = self._catalogue.find(reference, place)
            if entry is None:
                continue
            if self._is_ours(entry):
                self._catalogue.note(place, "is written by the daemon itself")
                continue
            if not entry.writable:
                self._catalogue.note(place, f"{entry.name!r} cannot be written")
            field, value = self._catalogue.field(entry, "setup"), given
            if isinstance(value, str):
                value = self._catalogue.resolve(field, value, place) or 0.0
            reads = entry.readable and reference not in self._bus.setup_unread
            try:
                found.append((entry, entry.encode(value), reads))
            except ValueError as problem:
                self._catalogue.note(place, str(problem))
        return tuple(found)

    def _is_ours(self, entry: Entry) -> bool:
        commanded = {CONTROLWORD, *(sink.item.address for sink in self._sinks)}
        in_pdos = _FIRST_PDO <= entry.index < _BEHIND_PDOS
        return entry.index in _OURS or in_pdos or entry.address in commanded
