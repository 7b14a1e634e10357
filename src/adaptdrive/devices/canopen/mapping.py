"""Mapping of objects to quantities: checks the configuration against its EDS, and packs PDOs.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from canopen.objectdictionary.datatypes import SIGNED_TYPES
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from adaptdrive.config.bus import CanOpenBus, Signals
from adaptdrive.devices import binding, description
from adaptdrive.devices.can.assembly import CommandFrame, StatusFrame
from adaptdrive.devices.can.bus import channel_flaws
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.canopen import dictionary
from adaptdrive.devices.canopen.dictionary import Address, Entry, ObjectCatalogue, label, read_eds
from adaptdrive.devices.canopen.profile import CONTROLWORD, CONTROLWORDS, STATUSWORD
from adaptdrive.devices.port import NewestValues
from adaptdrive.util.errors import ConfigurationError, Flaw

# Process data objects: packing entries into frames, and the codec of each frame.

_LARGEST_BITS = 64
"""Bits of a classic CAN frame."""

_LARGEST_ENTRIES = 8
"""Mapped objects of one PDO: at least a byte each."""


_FIRST_PDOS = {"TPDO": (0x180, 0x1800), "RPDO": (0x200, 0x1400)}
"""Frame id and index of the first PDO from a drive, and to it (CiA 301)."""

_PRECONFIGURED = 4
"""PDOs of each direction to which CiA 301 gives identifiers."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One process data object of the drive.

    Attributes:
        name: Such as `TPDO1`.
        cob_id: Frame id that the predefined connection set gives it.
        communication: Index of its communication parameters.
        mapping: Index of its mapping.
        entries: What travels in it, in this order; nothing in one that is switched off.
    """

    name: str
    cob_id: int
    communication: int
    mapping: int
    entries: tuple[Entry, ...] = ()


def pdos_of(kind: str, node_id: int) -> list[Pdo]:
    """Return the empty PDOs from a drive (`TPDO`) or to it (`RPDO`)."""
    cob_id, first = _FIRST_PDOS[kind]
    return [
        Pdo(f"{kind}{n + 1}", cob_id + 0x100 * n + node_id, first + n, first + 0x200 + n)
        for n in range(_PRECONFIGURED)
    ]


def pack(pdos: Sequence[Pdo], entries: Iterable[Entry]) -> list[Pdo] | None:
    """Put entries into as few PDOs as need be, each into the first one with room.

    Args:
        pdos: What the drive has, empty.
        entries: What must travel.

    Returns:
        The PDOs in use, None when there is no room for everything.
    """
    bins: list[list[Entry]] = [[] for _ in pdos]
    for entry in entries:
        chosen = next((one for one in bins if _has_room(one, entry)), None)
        if chosen is None:
            return None
        chosen.append(entry)
    filled = zip(pdos, bins, strict=True)
    return [replace(pdo, entries=tuple(found)) for pdo, found in filled if found]


def codec(pdo: Pdo) -> MessageCodec:
    """The codec of a PDO; its signals are raw values, named by the labels of their entries."""
    signals, start = [], 0
    for entry in pdo.entries:
        signals.append(_signal(entry, start))
        start += entry.bits
    return MessageCodec(Message(pdo.cob_id, pdo.name, (start + 7) // 8, signals))


def _has_room(entries: Sequence[Entry], entry: Entry) -> bool:
    bits = sum(one.bits for one in entries)
    return len(entries) < _LARGEST_ENTRIES and bits + entry.bits <= _LARGEST_BITS


def _signal(entry: Entry, start: int) -> Signal:
    return Signal(
        entry.label,
        start,
        entry.bits,
        is_signed=entry.variable.data_type in SIGNED_TYPES,
        conversion=BaseConversion.factory(is_float=not entry.coding.integer),
        minimum=entry.coding.low,
        maximum=entry.coding.high,
    )


# Mapping of objects to quantities: checks the configuration against its EDS.

Bound = TypeVar("Bound", description.Source[Entry], description.Sink[Entry])

_OPTIONAL = (
    dictionary.SYNC_ID,
    dictionary.SYNC_PERIOD,
    dictionary.ABORT_OPTION,
    dictionary.QUICK_STOP_OPTION,
)
_ASKED = {
    dictionary.SYNC_ID: "its SYNC is taken to be 0x080, as CiA 301 has it",
    dictionary.HEARTBEATS_HEARD: (
        "the drive is asked for it, and not used without: it monitors the daemon"
    ),
}
"""Objects that the drive may have although its EDS does not list them, and what is done then."""

_NEEDED = {
    dictionary.HEARTBEAT_SENT: "its heartbeat could not be monitored",
    CONTROLWORD: "it is no CiA 402 drive",
    STATUSWORD: "it is no CiA 402 drive",
}
WORD = "controlword"
"""Name of what a frame of the command carries besides the command."""

_WORD_BITS = 16
_OURS = frozenset(index for index, _ in (*_NEEDED, *_ASKED, *_OPTIONAL))
_FIRST_PDO, _BEHIND_PDOS = 0x1400, 0x1C00
_FIRST_OF_DEVICE = 0x2000
"""Objects below are communication parameters (CiA 301)."""


@dataclass(frozen=True, slots=True)
class CanOpenMapping:
    """Objects and properties of one drive, for its port.

    Attributes:
        sources: Every quantity that is measured.
        statuses: What is taken from the PDOs that the drive sends.
        orders: What goes into those that it takes; its controlword is a copy of that name.
        sent: PDOs that it sends.
        taken: PDOs that it takes.
        unused: PDOs of the drive that are switched off.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
        setup: Entries that the configuration writes, their bytes, whether they read as written.
        present: Optional entries that the drive has.
        identity: Identity object that the drive must have to be the one of the EDS.
        cautions: What can be used, and is probably not meant.
    """

    sources: tuple[description.Source[Entry], ...]
    statuses: tuple[StatusFrame, ...]
    orders: tuple[CommandFrame, ...]
    sent: tuple[Pdo, ...]
    taken: tuple[Pdo, ...]
    unused: tuple[Pdo, ...]
    counter_modulus: int | None
    setup: tuple[tuple[Entry, bytes, bool], ...]
    present: frozenset[Address]
    identity: tuple[tuple[Address, int], ...]
    cautions: tuple[Flaw, ...]

    def newest_values(self) -> NewestValues:
        """Return the values of the drive, none of which is known yet."""
        return NewestValues(self.sources, binding.BRIDGE)


def map_drive(
    bus: CanOpenBus,
    signals: Signals,
    source: Path | str = "configuration",
    demands: description.Demands = description.NO_DEMANDS,
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
    sources = [_labelled(one) for one in catalogue.sources(signals.entries(), demands)]
    sinks = catalogue.sinks(signals.command, demands)
    _check_needed(catalogue)
    sent = [catalogue.at(STATUSWORD), *(one.item for one in sources)]
    taken = [catalogue.at(CONTROLWORD), *(one.item for one in sinks)]
    transmits, unsent = _plan(catalogue, bus.node_id, "TPDO", sent)
    receives, untaken = _plan(catalogue, bus.node_id, "RPDO", taken)
    if catalogue.at(dictionary.ABORT_OPTION) is None:
        lacks = f"has no {label(dictionary.ABORT_OPTION)}: the daemon cannot make the drive disable"
        advice = "its voltage when the heartbeat stops; see in its manual that it does, and try it"
        catalogue.cautions.append(Flaw("bus.eds", f"{lacks} {advice}"))
    setup = tuple(_setup(catalogue, bus, {one.item.address for one in sinks}))
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    counters = (one for one in sources if one.quantity == "counter")
    return CanOpenMapping(
        sources=tuple(sources),
        statuses=tuple(StatusFrame(codec(pdo), _carried(pdo, sources)) for pdo in transmits),
        orders=tuple(_order(pdo, _carried(pdo, sinks)) for pdo in receives),
        sent=tuple(transmits),
        taken=tuple(receives),
        unused=(*unsent, *untaken),
        counter_modulus=next((int(one.field.high) + 1 for one in counters), None),
        setup=setup,
        present=frozenset(one for one in _OPTIONAL if catalogue.at(one)),
        identity=catalogue.identity,
        cautions=tuple(catalogue.cautions),
    )


def _carried(pdo: Pdo, bound: Iterable[Bound]) -> tuple[Bound, ...]:
    return tuple(one for one in bound if one.item in pdo.entries)


def _labelled(source: description.Source[Entry]) -> description.Source[Entry]:
    """Return a source whose field has the name of its signal in a PDO."""
    return replace(source, field=replace(source.field, name=source.item.label))


def _order(pdo: Pdo, sinks: Iterable[description.Sink[Entry]]) -> CommandFrame:
    """Return what goes into a PDO."""
    words = [one for one in pdo.entries if one.address == CONTROLWORD]
    return CommandFrame(
        codec(pdo),
        parts={one.item.label: one for one in sinks},
        fixed={},
        copies={one.label: description.Sink(WORD, one, one.coding, 0.0, 1.0) for one in words},
    )


def _check_needed(catalogue: ObjectCatalogue) -> None:
    """Refuse a drive without one of the objects that the daemon uses of each, or caution.

    The type of a controlword, or its limits in the EDS, may keep a command from being sent.
    """
    for address, consequence in _NEEDED.items():
        if catalogue.at(address) is None:
            missing = f"the EDS has no object {label(address)}: {consequence}"
            catalogue.note("bus.eds", missing + catalogue.remark(label(address)))
    for address, remedy in _ASKED.items():
        if catalogue.at(address) is None:
            lacks = f"has no {label(address)}: {remedy}{catalogue.remark(label(address))}"
            catalogue.cautions.append(Flaw("bus.eds", lacks))
    entry = catalogue.at(CONTROLWORD)
    if entry is None:
        return
    low, high = entry.coding.low, entry.coding.high
    refused = any(not low <= word <= high for word in CONTROLWORDS)
    if refused or not entry.coding.integer or entry.bits != _WORD_BITS:
        has = f"{entry.bits} bits from {low:g} to {high:g}"
        needs = f"{_WORD_BITS} bits with 0x00, 0x06, 0x07, 0x0F and 0x80"
        catalogue.note("bus.eds", f"{label(CONTROLWORD)} has {has}, it needs {needs}")


def _plan(
    catalogue: ObjectCatalogue, node_id: int, kind: str, entries: Iterable[Entry | None]
) -> tuple[list[Pdo], list[Pdo]]:
    """Return the PDOs that carry some entries, and those of the drive that carry nothing."""
    has = catalogue.has
    known = [one for one in pdos_of(kind, node_id) if has(one.communication) and has(one.mapping)]
    wanted = list(dict.fromkeys(entry for entry in entries if entry is not None))
    used = pack(known, wanted)
    if used is None:
        bits = sum(entry.bits for entry in wanted)
        problem = f"{bits} bits do not fit into the drive's {len(known)} {kind}s"
        catalogue.note("signals", problem)
        return [], known
    for pdo in used:
        count = catalogue.at((pdo.mapping, 0))
        if count is None or not count.variable.writable:
            catalogue.note("bus.eds", f"the mapping of {pdo.name} cannot be changed")
    names = {pdo.name for pdo in used}
    return used, [pdo for pdo in known if pdo.name not in names]


def _setup(
    catalogue: ObjectCatalogue, bus: CanOpenBus, commanded: Collection[Address]
) -> Iterator[tuple[Entry, bytes, bool]]:
    """Yield the entries that `[bus.setup]` writes."""
    for sink in catalogue.settings(bus.setup, "bus.setup", "setup"):
        entry = sink.item
        index = entry.address[0]
        in_pdos = _FIRST_PDO <= index < _BEHIND_PDOS
        if index in _OURS or in_pdos or entry.address in commanded:
            catalogue.note(f"bus.setup.{sink.name}", "is written by the daemon itself")
        reads = entry.variable.readable and sink.name not in bus.setup_unread
        yield entry, entry.variable.encode_raw(sink.field.raw(sink.base)), reads


def candidates(path: Path, node_id: int) -> Iterator[description.Candidate]:
    """Yield every object that may be a quantity.

    Args:
        path: EDS file.
        node_id: Node id of the drive.

    Raises:
        ConfigurationError: The file cannot be read, is no EDS, or has not what the daemon needs.
    """
    catalogue = ObjectCatalogue(*read_eds(path, node_id, path))
    _check_needed(catalogue)
    if catalogue.flaws:
        raise ConfigurationError(path, catalogue.flaws)
    for variable in catalogue.variables():
        entry, index = catalogue.at((variable.index, variable.subindex)), variable.index
        own = index >= _FIRST_OF_DEVICE and index not in {CONTROLWORD[0], STATUSWORD[0]}
        if entry and variable.pdo_mappable and own:
            yield description.Candidate(
                reference=entry.label,
                words=variable.qualname,
                unit="",
                range="",
                commanded=variable.writable,
                bits=entry.bits,
            )
