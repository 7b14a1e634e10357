"""From registers to a value and back, as `[bus.registers]` describes it."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from adaptdrive.config.polled import Register
from adaptdrive.devices.binding import Use
from adaptdrive.devices.field import Field, Raw, declared_limits, natural_limits, sensible_limits

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
    bits = register.bits is not None
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


def decode_value(register: Register, words: Sequence[int], *, measured: bool) -> float | None:
    """The scaled value, None when it must not be used.

    Args:
        register: How the value is coded.
        words: Its registers, as many as `register.words`.
        measured: Whether it is a measurement, and no word.
    """
    return decode(register, register_field("", register, "measured" if measured else "word"), words)


def decode(register: Register, field: Field, words: Sequence[int]) -> float | None:
    """The scaled value, None when it must not be used.

    Args:
        register: Which bits of the words.
        field: How they are coded.
        words: Its registers, as many as `register.words`.
    """
    raw = count(register, words)
    if register.bits is None:
        return field.value(raw)
    return None if raw in field.blanks else field.value(_masked(int(raw), register.bits))


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
        exact = count if register.real else round(count) * _lowest(register.bits)
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
    if register.bits is not None:
        natural = 0, _masked(register.bits, register.bits)
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
    missing = None if register.bits else _missing(register, measured=True)
    return frozenset({ones} if missing is None else {ones, missing})


def _ordered(register: Register, words: Sequence[int]) -> list[int]:
    """Words in the order of the wire, or back: the high one first where that is `big`."""
    ordered = list(words) if register.word_order == "big" else list(reversed(words))
    if register.byte_order == "big":
        return ordered
    return [word >> 8 | (word & 0xFF) << 8 for word in ordered]
