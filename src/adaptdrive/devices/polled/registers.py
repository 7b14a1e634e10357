"""Registers: values in them, and few requests for many of them within the wanted cycle.

Reads run across small gaps, writes never do.

A serial line carries one character of 10 or 11 bits per byte, one frame at a time, with silence
around each. On TCP the bytes cost next to nothing; the drive's turnaround is what counts.
"""

import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from adaptdrive.config.polled import ModbusLink, Register, RtuLink
from adaptdrive.devices.binding import Use
from adaptdrive.devices.field import Field, Raw, declared_limits, natural_limits, sensible_limits
from adaptdrive.util.errors import Flaw

# From registers to a value and back, as `[bus.registers]` describes it.

_FORMATS = {
    "uint16": ">H",
    "int16": ">h",
    "uint32": ">I",
    "int32": ">i",
    "float32": ">f",
    "uint64": ">Q",
    "int64": ">q",
    "float64": ">d",
}
_LARGEST_COUNT = 1 << 24
"""Largest number that a float holds as `not_available` names it; what is larger is its word."""


def register_field(name: str, register: Register, use: Use) -> Field:
    """Return how a register is coded.

    Args:
        name: Its name.
        register: The register.
        use: Its role. The count that means `no value` is refused of a measurement although the map
            names none, and must not read as off in a state; in a fault word all ones are as good
            as any other count.
    """
    measured = use == "measured"
    low, high = _limits(register)
    if measured and register.real:
        low, high = sensible_limits(low, high)
    missing = _missing(register, measured=measured)
    words: frozenset[Raw] = frozenset() if missing is None else frozenset({missing})
    bits = register.mask is not None
    blanks = words if bits else frozenset()
    if use == "state" and register.not_available is None and not register.real:
        blanks = _unsaid(register)
    return Field(
        name=name,
        scale=register.scale,
        low=low,
        high=high,
        integer=not register.real,
        blanks=blanks,
        unknown=frozenset() if bits else words,
        unit=register.unit,
        names={count: name for name, count in register.names.items()},
    )


def decode(register: Register, field: Field, words: Sequence[int]) -> float | None:
    """The scaled value, None when it must not be used.

    Args:
        register: Which bits of the words.
        field: How they are coded.
        words: Its registers, as many as `register.words`.
    """
    raw = count(register, words)
    if register.mask is None:
        return field.value(raw)
    return None if raw in field.blanks else field.value(_masked(int(raw), register.mask))


def _masked(raw: int, mask: int) -> int:
    """Return the number that some bits of a word are."""
    return (raw & mask) // _lowest(mask)


def _lowest(mask: int | None) -> int:
    """Return the lowest bit of a mask, 1 without one."""
    return 1 if mask is None else mask & -mask


def refusal(register: Register, field: Field, words: Sequence[int]) -> str:
    """Return what registers hold that must not be used, and why.

    Args:
        register: How the value is coded.
        field: The same.
        words: Its registers.
    """
    found, bounds = count(register, words), register.range
    raw = " ".join(f"{word:04x}" for word in words)
    held = f"holds {raw}, {found * register.scale:.10g} {register.unit}".strip()
    if found in field.unknown or found in field.blanks:
        return f"holds {raw}, its word for no value"
    if bounds is None or not math.isfinite(found):
        return f"{held}: no finite number"
    return f"{held}: outside {bounds.low:g}…{bounds.high:g}"


def encode_value(register: Register, value: float) -> list[int]:
    """The registers of a value.

    Raises:
        ValueError: The value is not finite, out of range, or the registers cannot hold it.
    """
    field = register_field("the value", register, "command")
    return encode_count(register, field.raw(value))


def encode_count(register: Register, count: float) -> list[int]:
    """The registers of a count; a fraction is rounded where the type is an integer.

    Raises:
        ValueError: The registers cannot hold it.
    """
    try:
        exact = count if register.real else round(count) * _lowest(register.mask)
        packed = struct.pack(_FORMATS[register.type], exact)
    except (struct.error, OverflowError, ValueError) as problem:
        raise ValueError(f"{register.type} cannot hold {count!r}") from problem
    return _ordered(register, struct.unpack(f">{register.words}H", packed))


def count(register: Register, words: Sequence[int]) -> Raw:
    """Return the count that registers hold."""
    packed = struct.pack(f">{register.words}H", *_ordered(register, words))
    found: Raw = struct.unpack(_FORMATS[register.type], packed)[0]
    return found


def _limits(register: Register) -> tuple[Raw, Raw]:
    """Return the lowest and the highest count: those of the type within those of the range."""
    if register.switches:
        return 0, 1
    natural = natural_limits(16 * register.words, signed=_signed(register), real=register.real)
    if register.mask is not None:
        natural = 0, _masked(register.mask, register.mask)
    if register.range is None:
        return natural
    return declared_limits(natural, (register.range.low, register.range.high), register.scale)


def _signed(register: Register) -> bool:
    return register.type.startswith("int")


def _missing(register: Register, *, measured: bool) -> Raw | None:
    """Return the count for no value; one that is given may be its word, without a sign."""
    given, span = register.not_available, 1 << (16 * register.words)
    if given is None:
        if register.real or register.switches or not measured:
            return None
        return -span // 2 if _signed(register) else span - 1
    if register.type == "float32" and given > _LARGEST_COUNT:
        found: float = struct.unpack(">f", struct.pack(">I", given))[0]
        return found
    return given - span if _signed(register) and given >= span // 2 else given


def _unsaid(register: Register) -> frozenset[Raw]:
    """Return the counts for no value where the map names none, as a gateway gives them.

    Of a bit all bits of its word count, as 0x8000 is a word of which one is set.
    """
    ones = -1 if _signed(register) else (1 << (16 * register.words)) - 1
    missing = None if register.mask else _missing(register, measured=True)
    return frozenset({ones} if missing is None else {ones, missing})


def _ordered(register: Register, words: Sequence[int]) -> list[int]:
    """Words in the order of the wire, or back: the high one first where that is `big`."""
    ordered = list(words) if register.order in {"ABCD", "BADC"} else list(reversed(words))
    if register.order in {"ABCD", "CDAB"}:
        return ordered
    return [word >> 8 | (word & 0xFF) << 8 for word in ordered]


# Few requests for many registers, and their time on the wire, compared with the wanted cycle.

Table = Literal["input", "holding", "coil", "discrete"]

USABLE_SHARE = 0.8
"""Share of the poll cycle that exchanges may take: a safe command must find the line free."""

RTU_FRAME = 3
"""Bytes around a message on a serial line: the device id, and the checksum."""

_TCP_HEADER = 7
_SILENCE_CHARACTERS = 3.5
"""Silence between two frames on a serial line (Modbus over serial line, 2.5.1.1)."""

_LEAST_SILENCE_S = 0.00175
"""The same above 19200 baud."""


@dataclass(frozen=True, slots=True)
class Block:
    """Neighbouring registers, asked for or written at once.

    Attributes:
        table: Kind of registers.
        address: First address, zero-based.
        count: Number of registers.
        single: Whether it is written alone: function 5 for a coil, 6 for a register.
        gap: Most neighbouring addresses in it that nobody wants.
    """

    table: Table
    address: int
    count: int
    single: bool = False
    gap: int = field(default=0, compare=False)

    @property
    def end(self) -> int:
        """Address behind the block."""
        return self.address + self.count

    def __str__(self) -> str:
        last = f"…{self.end - 1}" if self.count > 1 else ""
        return f"{self.table} {self.address}{last} (address from 0)"

    def holds(self, register: Register) -> bool:
        """Return whether a register lies in this block."""
        inside = self.address <= register.address and register.end <= self.end
        return register.table == self.table and inside


def plan_blocks(
    registers: Iterable[Register], max_gap: int, max_count: int, *, write: bool = False
) -> tuple[Block, ...]:
    """Cover registers with blocks.

    Args:
        registers: What is wanted; registers may share addresses.
        max_gap: Unwanted registers that a block may run across.
        max_count: Longest block; no value is ever cut in two.
        write: Whether they are written: each coil alone.
    """
    blocks: list[Block] = []
    for register in sorted(registers, key=lambda one: (one.table, one.address, one.end)):
        last = blocks[-1] if blocks else None
        single = write and (register.table == "coil" or max_count == 1)
        longest = 1 if single else max_count
        if last is not None and last.table == register.table:
            count = max(last.end, register.end) - last.address
            gap = register.address - last.end
            if gap <= max_gap and count <= longest:
                blocks[-1] = replace(last, count=count, gap=max(last.gap, gap))
                continue
        blocks.append(Block(register.table, register.address, register.words, single))
    return tuple(blocks)


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request and its reply.

    Attributes:
        read: Registers asked for, None for a write alone.
        write: Registers written, None for a read alone.
        device_id: Device on the link, None for the one that the link is configured for.
    """

    read: Block | None = None
    write: Block | None = None
    device_id: int | None = None

    def __str__(self) -> str:
        return " and ".join(str(block) for block in (self.read, self.write) if block is not None)

    @property
    def request_bytes(self) -> int:
        """Bytes of the request, without what frames it."""
        if self.write is None or self.write.single:
            return 5
        return 2 * self.write.count + (10 if self.read else 6)

    @property
    def reply_bytes(self) -> int:
        """Bytes of the reply, without what frames it."""
        if self.read is None:
            return 5
        bits = self.read.table in {"coil", "discrete"}
        return 2 + ((self.read.count + 7) // 8 if bits else 2 * self.read.count)


def silence_s(bus: ModbusLink) -> float:
    """Silence that separates two frames; none on TCP."""
    if not isinstance(bus, RtuLink):
        return 0.0
    return max(_LEAST_SILENCE_S, _SILENCE_CHARACTERS * _character_bits(bus) / bus.baud)


def exchange_bytes(bus: ModbusLink, exchange: Exchange) -> int:
    """Bytes of one exchange on this kind of link."""
    frame = RTU_FRAME if isinstance(bus, RtuLink) else _TCP_HEADER
    return exchange.request_bytes + exchange.reply_bytes + 2 * frame


def exchange_s(bus: ModbusLink, exchange: Exchange) -> float:
    """Time that one exchange takes, from request to request."""
    if not isinstance(bus, RtuLink):
        return bus.turnaround_s
    wire_s = exchange_bytes(bus, exchange) * _character_bits(bus) / bus.baud
    return wire_s + bus.turnaround_s + 2.0 * silence_s(bus)


def cycle_flaws(
    bus: ModbusLink,
    exchanges: Sequence[Exchange],
    cycle_s: float,
    key: str,
    tick_s: float | None = None,
) -> Iterator[Flaw]:
    """Yield why the exchanges of one cycle do not fit into it, with the link's figures.

    Args:
        bus: The link.
        exchanges: The exchanges of one cycle.
        cycle_s: The wanted cycle time.
        key: Key of the configuration that sets it, with its section.
        tick_s: Unit of the key, None for 1 s.
    """
    section, _, name = key.rpartition(".")
    took_s = [exchange_s(bus, exchange) for exchange in exchanges]
    needed_s = sum(took_s) / USABLE_SHARE
    if needed_s > cycle_s:
        asked = f"asks for a cycle of {cycle_s * 1e3:.1f} ms ({1.0 / cycle_s:.3g} per second)"
        takes = f"{_figures(bus, exchanges)} take {sum(took_s) * 1e3:.1f} ms"
        usable = f"{USABLE_SHARE:.0%} of the cycle may be used"
        fitting = f"{needed_s:.3g}" if tick_s is None else int(needed_s / tick_s) + 1
        yield Flaw(key, f"{asked}; {takes}, and {usable}: {name} = {fitting} fits")
    slowest_s = max(took_s, default=0.0)
    if bus.timeout_s <= slowest_s:
        slowest = f"the slowest exchange, {slowest_s * 1e3:.1f} ms"
        yield Flaw(f"{section}.timeout_s", f"{bus.timeout_s} s must be above {slowest}")


def _figures(bus: ModbusLink, exchanges: Sequence[Exchange]) -> str:
    total = sum(exchange_bytes(bus, exchange) for exchange in exchanges)
    wire = ""
    if isinstance(bus, RtuLink):
        wire = f" of {_character_bits(bus)} bits at {bus.baud} baud"
    turnaround = f"{bus.turnaround_s * 1e3:g} ms turnaround each"
    return f"{len(exchanges)} exchanges with {total} bytes{wire}, {turnaround},"


def _character_bits(bus: RtuLink) -> int:
    """Start bit, data, parity and stop bits."""
    return 9 + (bus.parity != "N") + bus.stop_bits
