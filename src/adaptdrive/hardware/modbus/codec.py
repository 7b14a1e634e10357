"""From registers to a value and back, as `[bus.registers]` describes it."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from adaptdrive.config.modbus import Register

_FORMATS = {"uint16": ">H", "int16": ">h", "uint32": ">I", "int32": ">i", "float32": ">f"}
_NOT_AVAILABLE = {
    "uint16": 0xFFFF,
    "int16": -0x8000,
    "uint32": 0xFFFF_FFFF,
    "int32": -0x8000_0000,
}


def decode_value(register: Register, words: Sequence[int], *, measured: bool) -> float | None:
    """The scaled value, None when it must not be used.

    Args:
        register: How the value is coded.
        words: Its registers, as many as `register.words`.
        measured: Whether the count that means `no value` is refused although the map names none;
            in a fault word all ones are as good as any other count.
    """
    count = _count(register, words)
    if count == _missing(register, measured=measured) or not math.isfinite(count):
        return None
    if register.bit is not None:
        return float(int(count) >> register.bit & 1)
    value = count * register.scale
    bounds = register.range
    if bounds is not None and not bounds.low <= value <= bounds.high:
        return None
    return value


def refusal(register: Register, words: Sequence[int], *, measured: bool) -> str:
    """Return what registers hold that `decode_value` refuses, and why.

    Args:
        register: How the value is coded.
        words: Its registers.
        measured: As for `decode_value`.
    """
    count, bounds = _count(register, words), register.range
    raw = " ".join(f"{word:04x}" for word in words)
    found = f"holds {raw}, {count * register.scale:.10g} {register.unit}".strip()
    if count == _missing(register, measured=measured):
        return f"holds {raw}, its word for no value"
    if bounds is None or not math.isfinite(count):
        return f"{found}: no finite number"
    return f"{found}: outside {bounds.low:g}…{bounds.high:g}"


def encode_value(register: Register, value: float) -> list[int]:
    """The registers of a value.

    Raises:
        ValueError: The value is not finite, out of range, or the registers cannot hold it.
    """
    bounds = register.range
    if not math.isfinite(value) or (bounds is not None and not bounds.low <= value <= bounds.high):
        raise ValueError(f"{value!r} {register.unit} is outside the register's range".strip())
    return encode_count(register, value / register.scale)


def encode_count(register: Register, count: float) -> list[int]:
    """The registers of a count; a fraction is rounded where the type is an integer.

    Raises:
        ValueError: The registers cannot hold it.
    """
    try:
        exact = count if register.type == "float32" else round(count)
        packed = struct.pack(_FORMATS[register.type], exact)
    except (struct.error, OverflowError) as problem:
        raise ValueError(f"{register.type} cannot hold {count!r}") from problem
    return _ordered(register, struct.unpack(f">{register.words}H", packed))


def _count(register: Register, words: Sequence[int]) -> float:
    packed = struct.pack(f">{register.words}H", *_ordered(register, words))
    count: float = struct.unpack(_FORMATS[register.type], packed)[0]
    return count


def _missing(register: Register, *, measured: bool) -> int | None:
    if register.not_available is not None or not measured:
        return register.not_available
    return _NOT_AVAILABLE.get(register.type)


def _ordered(register: Register, words: Sequence[int]) -> list[int]:
    """Words in the order of the wire, or back: the high one first where that is `big`."""
    return list(words) if register.word_order == "big" else list(reversed(words))
