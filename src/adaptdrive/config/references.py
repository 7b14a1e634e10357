"""Do `[signals]` and `[bus]` fit together? Each kind of bus names its signals in its own way."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping

from adaptdrive.config.bus import COMMANDED, CanOpenBus, Signals
from adaptdrive.config.modbus import ModbusBus, Register
from adaptdrive.config.proposals import nearest
from adaptdrive.config.scpi import ScpiBus
from adaptdrive.errors import Flaw

_LATE_HEARTBEATS = 2.0
"""Heartbeats that must fit into a time-out: one may go missing."""


def canopen_flaws(bus: CanOpenBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the contradictions to the profile that need no EDS to detect.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
    """
    if bus.own_node_id == bus.node_id:
        yield Flaw("bus.own_node_id", f"{bus.own_node_id} is the drive's own node id")
    if bus.heartbeat_timeout_s < _LATE_HEARTBEATS * bus.heartbeat_s:
        lowest = f"{_LATE_HEARTBEATS:g} times bus.heartbeat_s = {bus.heartbeat_s}"
        yield Flaw(
            "bus.heartbeat_timeout_s", f"{bus.heartbeat_timeout_s} must be at least {lowest}"
        )
    if signals.bridge is not None:
        yield Flaw("signals.bridge", "the statusword 0x6041 contains it: leave it out")
    if signals.command.bridge is not None:
        yield Flaw("signals.command.bridge", "the controlword 0x6040 carries it: leave it out")
    if signals.counter is not None and bus.sync == "daemon":
        yield Flaw(
            "signals.counter", "bus.sync = 'daemon' makes the daemon the clock: leave it out"
        )


def scpi_flaws(bus: ScpiBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the errors in the values of a supply, and in references to them.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
    """
    if not bus.done and signals.bridge is None:
        yield Flaw("bus.done", "is empty: signals.bridge must be asked for, to confirm a stop")
    for name, register in bus.as_registers().registers.items():
        yield from register_flaws(f"bus.values.{name}", register)
    written = [*commanded_names(signals), *((f"bus.setup.{name}", name) for name in bus.setup)]
    for line, references in (("query", measured_names(signals)), ("write", written)):
        yield from unknown_flaws(references, bus.values, "[bus.values] has no value")
        for place, name in references:
            if name in bus.values and getattr(bus.values[name], line) is None:
                yield Flaw(place, f"bus.values.{name} has no `{line}`")


def modbus_flaws(bus: ModbusBus, signals: Signals) -> Iterator[Flaw]:
    """Yield the errors in a register map, and in references to it."""
    for name, register in bus.registers.items():
        yield from register_flaws(f"bus.registers.{name}", register)
    yield from map_flaws("bus.registers", bus.registers, zero_based=bus.zero_based)
    written, read = _written(bus, signals), [*measured_names(signals), *_heartbeat(bus, "drive")]
    yield from unknown_flaws([*read, *written], bus.registers, "[bus.registers] has no register")
    for place, name in written:
        target = bus.registers.get(name)
        whole = target is None or target.bits is None or not place.startswith("bus.")
        if target is not None and (target.table in {"input", "discrete"} or not whole):
            kind = "whole holding register" if target.bits else "holding register"
            yield Flaw(place, f"{name!r} cannot be written: it must be a {kind} or a coil")
    yield from _beat_flaws(bus)
    yield from _overlap_flaws(bus, signals)


def measured_names(signals: Signals) -> list[tuple[str, str]]:
    """Place and name of each signal that carries a measurement."""
    return [(f"{place}.signal", one.signal) for _, one, place in signals.entries()]


def commanded_names(signals: Signals) -> list[tuple[str, str]]:
    """Place and name of each signal that carries a part of the command."""
    given, place = signals.command, "signals.command"
    named = ((name, getattr(given, name)) for name in COMMANDED)
    values = [(f"{place}.{name}", one.signal) for name, one in named if one is not None]
    if given.bridge is not None and given.bridge.off_signal is not None:
        values.append((f"{place}.bridge.off_signal", given.bridge.off_signal))
    return [*values, *((f"{place}.constants.{one}", one) for one in given.constants)]


def _heartbeat(bus: ModbusBus, side: str) -> list[tuple[str, str]]:
    name = getattr(bus.heartbeat, side)
    return [] if name is None else [(f"bus.heartbeat.{side}", name)]


def _written(bus: ModbusBus, signals: Signals) -> list[tuple[str, str]]:
    setup = [(f"bus.setup.{name}", name) for name in bus.setup]
    return [*commanded_names(signals), *_heartbeat(bus, "daemon"), *setup]


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


def register_flaws(place: str, register: Register) -> Iterator[Flaw]:
    """Yield the errors in a single register."""
    if register.end > 0x10000:
        yield Flaw(f"{place}.address", f"{register.address} leaves no room for its registers")
    if register.scale == 0.0:
        yield Flaw(f"{place}.scale", "must not be 0")
    if register.range is not None and register.range.low >= register.range.high:
        low, high = register.range.low, register.range.high
        yield Flaw(f"{place}.range", f"low = {low} must be below high = {high}")
    given, bits = register.not_available, 16 * register.words
    lowest = 0 if register.type.startswith("uint") else -1 << (bits - 1)
    if given is not None and not lowest <= given < 1 << bits:
        yield Flaw(f"{place}.not_available", f"{register.type} has no count {given}")
    if register.bits is not None and (register.real or register.bits >> bits):
        wrong = f"bit {register.bit}" if register.mask is None else f"bits {register.mask:#x}"
        yield Flaw(
            f"{place}.{'bit' if register.mask is None else 'mask'}",
            f"{register.type} has no {wrong}",
        )
    if register.bit is not None and register.mask is not None:
        yield Flaw(f"{place}.mask", "is for several bits, and `bit` for one")
    if register.switches and (register.type != "uint16" or register.bits is not None):
        yield Flaw(f"{place}.type", f"a {register.table} is one bit: leave type, bit and mask out")


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
    last: tuple[str, Register] | None = None
    for name, register in sorted(registers.items(), key=lambda item: _position(item[1])):
        if last is not None and _collide(last[1], register):
            problem = f"{_span(register)} and {last[0]!r} {_span(last[1])} share a register"
            yield Flaw(f"{place}.{name}", f"{problem}: one is read or written wrongly")
        if (
            last is None
            or _position(register)[:1] != _position(last[1])[:1]
            or (register.end >= last[1].end)
        ):
            last = name, register


def _position(register: Register) -> tuple[str, int, int]:
    return register.table, register.address, register.end


def _span(register: Register) -> str:
    last = f"…{register.end - 1}" if register.words > 1 else ""
    return f"({register.type}, {register.address}{last})"


def _collide(first: Register, second: Register) -> bool:
    """Return whether two values share a register and are neither equal nor bits of one word."""
    if first.table != second.table or first.end <= second.address:
        return False
    if first.bits is not None or second.bits is not None:
        return False
    coded = [
        (one.address, one.type, one.word_order, one.byte_order, one.scale)
        for one in (first, second)
    ]
    return coded[0] != coded[1]


_LABELS = {"input": 30001, "holding": 40001}
_LABELS_OF_A_TABLE = 9999


def _label_flaws(place: str, register: Register) -> Iterator[Flaw]:
    """An address that is probably copied from a manual as it is printed there."""
    for table, first in _LABELS.items():
        if not first <= register.address < first + _LABELS_OF_A_TABLE:
            continue
        label = f"{register.address} looks like a label of the {table} table in a manual"
        meant = f"address = {register.address - first}, table = {table!r}"
        advice = "or zero_based = true with the bus where the address is meant as it stands"
        yield Flaw(place, f"{label}; zero-based that is {meant}; {advice}")


def _beat_flaws(bus: ModbusBus) -> Iterator[Flaw]:
    """Heartbeats are counts as they stand."""
    for place, name in (*_heartbeat(bus, "drive"), *_heartbeat(bus, "daemon")):
        register = bus.registers.get(name)
        if register is not None and (register.real or register.scale != 1.0):
            yield Flaw(place, f"register {name!r} must be an integer with scale 1")


def _overlap_flaws(bus: ModbusBus, signals: Signals) -> Iterator[Flaw]:
    written = [
        (place, name, bus.registers[name])
        for place, name in _written(bus, signals)
        if name in bus.registers
    ]
    for (_, first, one), (place, second, other) in itertools.combinations(written, 2):
        if _overlap(one, other):
            yield Flaw(place, f"{second!r} lies in the same register as {first!r}")
    for place, name in _heartbeat(bus, "drive"):
        for _, first, one in written:
            if name in bus.registers and _overlap(one, bus.registers[name]):
                problem = "which the daemon writes: it does not show that the drive is alive"
                yield Flaw(place, f"{name!r} lies in the register of {first!r}, {problem}")


def _overlap(one: Register, other: Register) -> bool:
    if one.table != other.table or one.end <= other.address or other.end <= one.address:
        return False
    fields = one.bits is not None and other.bits is not None and one.address == other.address
    return not (fields and one.type == other.type and not (one.bits or 0) & (other.bits or 0))
