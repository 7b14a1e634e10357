"""The register map from the drive's side: what is measured there is written here.

The drive reads the same configuration as the daemon. A table has every address from its first
register to its last; what lies between and is not mapped reads as 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from adaptdrive.config.bus import COMMANDED, MEASURED, Signals, SignalSource
from adaptdrive.config.polled import ModbusBus, Register
from adaptdrive.control.signals import Command
from adaptdrive.devices.field import Field, Raw
from adaptdrive.devices.polled.registers import (
    decode_value,
    encode_count,
    encode_value,
    register_field,
)
from adaptdrive_sim.devices.frames import QUANTITIES

Table = dict[int, int]


class RegisterImage:
    """The registers of one drive.

    Attributes:
        tables: Content by address, for input and holding registers.
    """

    def __init__(self, bus: ModbusBus, signals: Signals) -> None:
        self._bus = bus
        self._signals = signals
        self.tables: dict[str, Table] = {
            table: addresses(bus.registers.values(), table) for table in ("input", "holding")
        }

    def show(self, quantities: Mapping[str, float]) -> None:
        """Put a half cycle's quantities into the registers."""
        words: dict[tuple[str, int], int] = {}
        for name, source in self._shown():
            register = self._bus.registers[source.signal]
            value = (quantities[name] - source.offset) / source.scale
            if name in MEASURED:
                _place(words, register, encode_value(register, bounded(register, value)))
            else:
                _place(words, register, encode_count(register, _wrapped(register, int(value))))
        for (table, address), word in words.items():
            self.tables[table][address] = word

    def command(self, tables: Mapping[str, Table]) -> Command | None:
        """Return the command of the daemon; None when a register has an invalid value."""
        found: dict[str, float] = {"current_scale_S": 0.0, "boost_reference_V": 0.0}
        for name in COMMANDED:
            given = getattr(self._signals.command, name)
            if given is None:
                continue
            register = self._bus.registers[given.signal]
            words = [tables[register.table][a] for a in range(register.address, register.end)]
            value = decode_value(register, words, measured=False)
            if value is None:
                return None
            if isinstance(given, SignalSource):
                found[name] = value * given.scale + given.offset
            else:
                found[name] = value == _switching(given.on, register.on, register)
        return Command(**found)  # type: ignore[arg-type]

    def heartbeat(self, tables: Mapping[str, Table]) -> tuple[int, ...] | None:
        """The daemon's heartbeat as it stands, None where the map has none."""
        name = self._bus.heartbeat.daemon
        if name is None:
            return None
        register = self._bus.registers[name]
        return tuple(tables[register.table][a] for a in range(register.address, register.end))

    def _shown(self) -> Iterator[tuple[str, SignalSource]]:
        for name, source, _ in self._signals.entries():
            if name in QUANTITIES:
                yield name, source
        if self._bus.heartbeat.drive is not None:
            yield "counter", SignalSource(signal=self._bus.heartbeat.drive)


def addresses(registers: Iterable[Register], table: str) -> Table:
    """Return a table from the first register to the last, filled with 0."""
    spans = [(one.address, one.end) for one in registers if one.table == table]
    if not spans:
        return {}
    return dict.fromkeys(range(min(a for a, _ in spans), max(b for _, b in spans)), 0)


def not_available(register: Register) -> float:
    """The count that means `no value`."""
    if register.not_available is not None:
        return register.not_available
    if register.real:
        return math.nan
    span = 1 << 16 * register.words
    return -span // 2 if register.type.startswith("int") else span - 1


def _place(words: dict[tuple[str, int], int], register: Register, content: Sequence[int]) -> None:
    """Put registers down; bits that share a register are joined."""
    for number, word in enumerate(content, register.address):
        beside = 0 if register.bits is None else words.get((register.table, number), 0)
        words[register.table, number] = word | beside


def _switching(given: int | str | None, usual: int, register: Register) -> int:
    """Return the count of a switch, which a configuration may name."""
    if given is None:
        return usual
    return register.names[given] if isinstance(given, str) else given


def bounded(register: Register, value: float) -> float:
    """Like a converter's, a value ends at the range of its register."""
    field = register_field("", register, "measured")
    low, high = sorted(field.physical(end) for end in _without(field))
    if register.range is not None:
        low, high = max(low, register.range.low), min(high, register.range.high)
    return min(max(value, low), high)


def _without(field: Field) -> tuple[Raw, Raw]:
    """Return the lowest and the highest count, without the one for no value."""
    low, high = field.low, field.high
    return low + (low in field.unknown), high - (high in field.unknown)


def _wrapped(register: Register, count: int) -> int:
    return count % (1 << (16 * register.words - register.type.startswith("int")))
