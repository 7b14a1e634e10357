"""References of `[signals]` to what `[bus]` describes, and register maps.

Each kind of bus names its signals in its own way, and has its own time between two readings.
"""

import itertools
import operator
from collections.abc import Iterable, Iterator, Mapping

from adaptdrive.config.bus import COMMANDED, CanBus, CanOpenBus, Signals
from adaptdrive.config.polled import ModbusBus, Register, ScpiBus
from adaptdrive.util.errors import Flaw, nearest

DAY_S = 86400.0

_DRIVE_BEAT = "bus.heartbeat.drive"
_CODING = operator.attrgetter("address", "type", "order", "scale")


def reference_flaws(
    bus: CanBus | CanOpenBus | ModbusBus | ScpiBus, signals: Signals
) -> Iterator[Flaw]:
    """Yield the signals that do not fit the bus; those of CAN are compared with the DBC.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
    """
    if isinstance(bus, CanOpenBus):
        yield from _canopen_flaws(bus, signals)
    elif isinstance(bus, ScpiBus):
        yield from scpi_flaws(bus, signals)
    elif isinstance(bus, ModbusBus):
        yield from _modbus_flaws(bus, signals)


def _canopen_flaws(bus: CanOpenBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the contradictions to the profile that need no EDS to detect."""
    if bus.own_node_id == bus.node_id:
        yield Flaw("bus.own_node_id", f"{bus.own_node_id} is the drive's own node id")
    if signals.bridge is not None:
        yield Flaw("signals.bridge", "the statusword 0x6041 contains it: leave it out")
    if signals.command.bridge is not None:
        yield Flaw("signals.command.bridge", "the controlword 0x6040 carries it: leave it out")
    if signals.command.reset is not None:
        yield Flaw("signals.command.reset", "the controlword 0x6040 carries it: leave it out")
    if signals.counter is not None and bus.sync == "daemon":
        clock = "bus.sync = 'daemon' makes the daemon the clock"
        yield Flaw("signals.counter", f"{clock}: leave it out")


def scpi_flaws(bus: ScpiBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the errors in the values of a supply, and in references to them.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
    """
    if not bus.done and signals.bridge is None:
        yield Flaw("bus.done", "is empty: signals.bridge must be asked for, to confirm a stop")
    written = [*commanded_names(signals), *((f"bus.setup.{name}", name) for name in bus.setup)]
    for line, references in (("query", measured_names(signals)), ("write", written)):
        yield from unknown_flaws(references, bus.values, "[bus.values] has no value")
        for place, name in references:
            text = getattr(bus.values[name], line) if name in bus.values else "{}"
            if text is None:
                yield Flaw(place, f"bus.values.{name} has no `{line}`")
            elif line == "write" and place.rpartition(".")[2] in COMMANDED and "{" not in text:
                yield Flaw(place, f"bus.values.{name}.write = {text!r} has no {{}} for the value")


def _modbus_flaws(bus: ModbusBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the errors in a register map, and in references to it."""
    registers, beats = bus.registers, bus.heartbeat
    yield from map_flaws("bus.registers", registers, zero_based=bus.zero_based)
    seen = [] if beats.drive is None else [(_DRIVE_BEAT, beats.drive)]
    beaten = [] if beats.daemon is None else [("bus.heartbeat.daemon", beats.daemon)]
    setup = [(f"bus.setup.{name}", name) for name in bus.setup]
    written = [*commanded_names(signals), *beaten, *setup]
    references = [*measured_names(signals), *seen, *written]
    yield from unknown_flaws(references, registers, "[bus.registers] has no register")
    for place, name in written:
        target = registers.get(name)
        if target is None:
            continue
        if target.table in {"input", "discrete"} or (target.mask and place.startswith("bus.")):
            wanted = "a holding register, whole for [bus], or a coil"
            yield Flaw(place, f"{name!r} cannot be written: it must be {wanted}")
    for place, name in (*seen, *beaten):
        if name in registers and (registers[name].real or registers[name].scale != 1.0):
            yield Flaw(place, f"register {name!r} must be an integer with scale 1")
    yield from _overlap_flaws([one for one in (*written, *seen) if one[1] in registers], registers)


def _overlap_flaws(
    written: Iterable[tuple[str, str]], registers: Mapping[str, Register]
) -> Iterator[Flaw]:
    """Yield the parts of a command that share bits; the drive's heartbeat is no part of one."""
    for (_, first), (place, name) in itertools.combinations(written, 2):
        one, other = registers[first], registers[name]
        alike = (one.address, one.type) == (other.address, other.type)
        apart = alike and one.mask and other.mask and not one.mask & other.mask
        if apart or not _meet(one, other):
            continue
        if place == _DRIVE_BEAT:
            problem = "which the daemon writes: it does not show that the drive is alive"
            yield Flaw(place, f"{name!r} lies in the register of {first!r}, {problem}")
        else:
            yield Flaw(place, f"{name!r} lies in the same register as {first!r}")


def measured_names(signals: Signals) -> list[tuple[str, str]]:
    """Place and name of each signal that carries a measurement."""
    return [(f"{place}.signal", one.signal) for _, one, place in signals.entries()]


def commanded_names(signals: Signals) -> list[tuple[str, str]]:
    """Place and name of each signal that carries a part of the command."""
    given, place = signals.command, "signals.command"
    named = ((name, getattr(given, name)) for name in (*COMMANDED, "reset"))
    values = [(f"{place}.{name}", one.signal) for name, one in named if one is not None]
    if given.bridge is not None and given.bridge.off_signal is not None:
        values.append((f"{place}.bridge.off_signal", given.bridge.off_signal))
    return [*values, *((f"{place}.constants.{one}", one) for one in given.constants)]


def unknown_flaws(
    references: Iterable[tuple[str, str]], known: Mapping[str, object], problem: str
) -> Iterator[Flaw]:
    """Yield the references to names that are not there.

    Args:
        references: Place and name of each.
        known: What is there, by name.
        problem: What is said before the name.
    """
    for place, name in references:
        if name not in known:
            yield Flaw(place, f"{problem} {name!r}{nearest(name, known)}")


def map_flaws(place: str, registers: Mapping[str, Register], *, zero_based: bool) -> Iterator[Flaw]:
    """Yield the errors in the combination of the registers of one device.

    Args:
        place: Where they stand in the configuration.
        registers: By name.
        zero_based: Whether addresses that look like labels are none.
    """
    if not zero_based:
        for name, register in registers.items():
            yield from _label_flaws(f"{place}.{name}.address", register)
    whole = [(name, register) for name, register in registers.items() if register.mask is None]
    whole.sort(key=lambda item: (item[1].table, item[1].address))
    for (first, one), (name, other) in itertools.pairwise(whole):
        if _meet(one, other) and _CODING(one) != _CODING(other):
            pair = f"{other.type} at {other.address} and {first!r}, {one.type} at {one.address},"
            problem = "share a register: one is read or written wrongly"
            yield Flaw(f"{place}.{name}", f"{pair} {problem}")


def _meet(one: Register, other: Register) -> bool:
    """Return whether two values share a register."""
    return one.table == other.table and one.address < other.end and other.address < one.end


_LABELS = {"input": 30001, "holding": 40001}
_LABELS_OF_A_TABLE = 9999


def _label_flaws(place: str, register: Register) -> Iterator[Flaw]:
    """An address that is probably copied from a manual as it is printed there."""
    for table, first in _LABELS.items():
        if first <= register.address < first + _LABELS_OF_A_TABLE:
            label = f"{register.address} looks like a label of the {table} table in a manual"
            meant = f"address = {register.address - first}, table = {table!r}"
            advice = "or zero_based = true with the bus where the address is meant as it stands"
            yield Flaw(place, f"{label}; zero-based that is {meant}; {advice}")
