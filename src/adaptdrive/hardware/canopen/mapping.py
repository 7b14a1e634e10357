"""Mapping of objects to quantities: checks the configuration against its EDS.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.config.bus import Signals
from adaptdrive.config.canopen import CanOpenBus
from adaptdrive.config.references import COMMANDED, MEASURED, WORDS
from adaptdrive.errors import ConfigurationError
from adaptdrive.hardware.canopen.dictionary import (
    Address,
    Entry,
    ObjectCatalogue,
    label,
    load_dictionary,
)
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
from adaptdrive.hardware.demands import NO_DEMANDS, Demands, is_whole
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
class MappedObject:
    """Source of a measured quantity, or destination of a commanded one.

    Attributes:
        quantity: Field of `Reading`, a name in its `other`, or a field of `Command`.
        entry: Entry of the object dictionary.
        scale: SI units per count.
        offset: SI value of the count zero.
    """

    quantity: str
    entry: Entry
    scale: float
    offset: float


@dataclass(frozen=True, slots=True)
class StatusPdo:
    """A PDO that carries measurements, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[MappedObject, ...]


@dataclass(frozen=True, slots=True)
class CommandPdo:
    """A PDO that carries the command, its controlword or both."""

    codec: MessageCodec
    sinks: tuple[MappedObject, ...]
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
        setup: Entries that the configuration writes, and their bytes.
        present: Optional entries that the drive has.
        identity: Identity object that the drive must have to be the one of the EDS.
    """

    transmits: tuple[Pdo, ...]
    receives: tuple[Pdo, ...]
    unused: tuple[Channel, ...]
    statuses: tuple[StatusPdo, ...]
    orders: tuple[CommandPdo, ...]
    counter_modulus: int | None
    setup: tuple[tuple[Entry, bytes], ...]
    present: frozenset[Address]
    identity: tuple[tuple[Address, int], ...]

    @property
    def sources(self) -> tuple[MappedObject, ...]:
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
    dictionary = load_dictionary(bus.eds, bus.node_id, source)
    catalogue = ObjectCatalogue(dictionary)
    catalogue.flaws.extend(channel_flaws(bus))
    plan = _Plan(catalogue, bus)
    plan.find_sources(signals)
    plan.find_sinks(signals, demands)
    mapping = plan.mapping()
    if mapping is None or catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return mapping


class _Plan:
    """Collects the requested objects, and the errors in them."""

    def __init__(self, catalogue: ObjectCatalogue, bus: CanOpenBus) -> None:
        self._catalogue = catalogue
        self._bus = bus
        self._sources: list[MappedObject] = []
        self._sinks: list[MappedObject] = []
        for address, consequence in _NEEDED.items():
            if catalogue.at(address) is None:
                missing = f"the EDS has no object {label(address)}: {consequence}"
                catalogue.note("bus.eds", missing)
        self._check_controlword(catalogue.at(CONTROLWORD))

    def find_sources(self, signals: Signals) -> None:
        """Entries of the measured quantities."""
        named = [(name, getattr(signals, name), f"signals.{name}") for name in (*MEASURED, *WORDS)]
        others = [(name, one, f"signals.other.{name}") for name, one in signals.other.items()]
        for quantity, given, place in (*named, *others):
            if given is None:
                continue
            entry = self._catalogue.find(given.signal, place)
            if entry is None:
                continue
            if not (entry.readable and entry.mappable):
                self._catalogue.note(place, f"the drive does not send {entry.name!r} in a PDO")
            source = MappedObject(quantity, entry, given.scale, given.offset)
            self._sources.append(source)
            if quantity in WORDS:
                self._check_word(source, place)

    def find_sinks(self, signals: Signals, demands: Demands) -> None:
        """Entries of the commanded quantities, which must carry what is demanded."""
        for name in COMMANDED:
            given = getattr(signals.command, name)
            if given is None:
                continue
            place = f"signals.command.{name}"
            entry = self._catalogue.find(given.signal, place)
            if entry is None:
                continue
            if not (entry.writable and entry.mappable):
                self._catalogue.note(place, f"the drive does not take {entry.name!r} in a PDO")
            rest = -given.offset / given.scale
            whole = entry.real or is_whole(rest)
            if not (whole and entry.limits[0] <= rest <= entry.limits[1]):
                self._catalogue.note(place, f"{entry.name!r} cannot be 0: it could not be safe")
            for wanted in demands.values(name):
                if not entry.limits[0] <= (wanted - given.offset) / given.scale <= entry.limits[1]:
                    problem = f"{entry.name!r} cannot carry {wanted:g}, a limit of [drive.limits]"
                    ends = "{:g}…{:g}".format(*entry.limits)
                    self._catalogue.note(place, f"{problem}: its counts are {ends}")
            self._sinks.append(MappedObject(name, entry, given.scale, given.offset))

    def mapping(self) -> CanOpenMapping | None:
        """Return the mapping; None when errors were found."""
        transmitted = [self._catalogue.at(STATUSWORD), *(source.entry for source in self._sources)]
        received = [self._catalogue.at(CONTROLWORD), *(sink.entry for sink in self._sinks)]
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

    def _check_word(self, source: MappedObject, place: str) -> None:
        entry = source.entry
        if (source.scale, source.offset) != (1.0, 0.0):
            self._catalogue.note(place, "is an integer: it takes no scale and no offset")
        if entry.real or (source.quantity == "counter" and entry.signed):
            self._catalogue.note(place, f"{entry.name!r} is no unsigned integer")

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
        sources = tuple(source for source in self._sources if source.entry in pdo.entries)
        return StatusPdo(codec(pdo), sources)

    def _order(self, pdo: Pdo) -> CommandPdo:
        sinks = tuple(sink for sink in self._sinks if sink.entry in pdo.entries)
        controlword = any(entry.address == CONTROLWORD for entry in pdo.entries)
        return CommandPdo(codec(pdo), sinks, controlword)

    def _modulus(self) -> int | None:
        for source in self._sources:
            if source.quantity == "counter":
                return int(source.entry.limits[1]) + 1
        return None

    def _setup(self) -> tuple[tuple[Entry, bytes], ...]:
        found = []
        for reference, value in self._bus.setup.items():
            place = f"bus.setup.{reference}"
            entry = self._catalogue.find(reference, place)
            if entry is None:
                continue
            if self._is_ours(entry):
                self._catalogue.note(place, "is written by the daemon itself")
                continue
            if not entry.writable:
                self._catalogue.note(place, f"{entry.name!r} cannot be written")
            try:
                found.append((entry, entry.encode(value)))
            except ValueError as problem:
                self._catalogue.note(place, str(problem))
        return tuple(found)

    def _is_ours(self, entry: Entry) -> bool:
        commanded = {CONTROLWORD, *(sink.entry.address for sink in self._sinks)}
        in_pdos = _FIRST_PDO <= entry.index < _BEHIND_PDOS
        return entry.index in _OURS or in_pdos or entry.address in commanded
