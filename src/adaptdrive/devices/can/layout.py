"""Positions of the bits of a signal: a DBC's layout, compiled for the fast path.

Integers of either byte order are cut out of one big integer by shift and mask. Whatever else a DBC
can describe (floating point and multiplexed signals) takes the slow way through cantools, with the
same results.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from os.path import commonprefix
from typing import Literal, NamedTuple, cast

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.devices.field import Field, Raw, declared_limits, natural_limits, sensible_limits

Unpack = Callable[[bytes], Mapping[str, Raw]]
Pack = Callable[[Mapping[str, Raw]], bytes]
_ByteOrder = Literal["little", "big"]

_UNKNOWN = re.compile(
    "(sna|n/?a|unknown|undefined|invalid)$|(signal[ _]?)?(not[ _]?available|unavailable)",
    re.IGNORECASE,
)
"""Names of a raw value that says nothing."""


def compile_field(
    signal: Signal, *, measured: bool = False, state: bool = False, on: float | None = None
) -> Field:
    """Compile one signal.

    Args:
        signal: The signal.
        measured: Whether the largest raw value means "not available" even where the range that the
            DBC declares (or fails to declare) has room for it, and whatever its value table names
            next to the ends ("error") is no value either.
        state: Whether a value whose name says that nothing is known ("SNA") is none.
        on: Value of a state that means on. With it, all bits set are none unless they have a name.
    """
    bottom, top = _natural_limits(signal)
    low, high = _declared_limits(signal)
    if measured and signal.is_float:
        low, high = sensible_limits(low, high)
    elif measured and signal.length > 1:
        names = list(signal.choices or ())
        high = high if high < top - 1 else _below_names(names, top - 1)
        if signal.is_signed and low == bottom:
            low = -_below_names([-raw for raw in names], -low)
    return Field(
        name=signal.name,
        scale=signal.scale,
        offset=signal.offset,
        low=low,
        high=high,
        integer=not signal.is_float,
        unavailable=math.nan if signal.is_float else top,
        idle=initial_value(signal) or 0,
        unknown=_unknown_states(signal, on) if state else frozenset(),
        unit=signal.unit or "",
        names={int(raw): str(name) for raw, name in (signal.choices or {}).items()},
    )


def initial_value(signal: Signal) -> Raw | None:
    """Return the raw initial value of a signal, 0 where it has none; None where it cannot hold it.

    A DBC may declare the initial values of all its signals, integers too, as floating point.

    Args:
        signal: The signal.
    """
    raw: Raw = signal.raw_initial or 0
    low, high = _natural_limits(signal)
    if not low <= raw <= high:
        return None
    if signal.is_float:
        return raw
    return int(raw) if raw == int(raw) else None


def _natural_limits(signal: Signal) -> tuple[Raw, Raw]:
    return natural_limits(signal.length, signed=signal.is_signed, real=signal.is_float)


def _declared_limits(signal: Signal) -> tuple[Raw, Raw]:
    natural = _natural_limits(signal)
    unlimited = not (signal.minimum or signal.maximum)  # 0|0 in any spelling
    if signal.minimum is None or signal.maximum is None or unlimited or not signal.scale:
        return natural
    return declared_limits(natural, (signal.minimum, signal.maximum), signal.scale, signal.offset)


def _unknown_states(signal: Signal, on: float | None) -> frozenset[Raw]:
    """Return the raw values that say nothing; a prefix that all names share is no part of them."""
    names = {raw: str(name) for raw, name in (signal.choices or {}).items()}
    shared = commonprefix(list(names.values()))  # noqa: RUF071 - names, no paths
    behind = max(shared.rfind("_"), shared.rfind(" ")) + 1
    blank = -1 if signal.is_signed else _natural_limits(signal)[1]
    known = on is None or signal.length == 1 or blank * signal.scale + signal.offset == on
    return frozenset(
        raw for raw, name in names.items() if _UNKNOWN.match(name) or _UNKNOWN.match(name[behind:])
    ).union(() if known or blank in names else (blank,))


def _below_names(names: Collection[int], end: Raw) -> Raw:
    """The end of a range without the raw values there that have names, such as "error"."""
    while end in names:
        end -= 1
    return end


def compile_unpack(message: Message, names: Iterable[str]) -> Unpack:
    """Return a function from the bytes of a frame to the raw values of some of its signals.

    Args:
        message: The message; a multiplexed one gives the signals that its frame has.
        names: The signals wanted.
    """
    signals = [message.get_signal_by_name(name) for name in names]
    if not all(map(_is_plain, signals)):
        return _slow_unpack(message, frozenset(signal.name for signal in signals))
    little, big = _cuts(message, signals, "little"), _cuts(message, signals, "big")
    cut_little, cut_big = _cutter(little, "little"), _cutter(big, "big")
    if not (little and big):
        return cut_big if big else cut_little
    return lambda data: {**cut_little(data), **cut_big(data)}


def compile_pack(message: Message, idle: Mapping[str, Raw]) -> Pack:
    """Return a function from the raw values of some signals of a message to the bytes of its frame.

    Args:
        message: The message.
        idle: Raw values of all its signals, for those that the function is not given.
    """
    if not all(map(_is_plain, message.signals)):
        return lambda raw: message.encode({**idle, **raw}, scaling=False, strict=False)
    little, big = (_cuts(message, message.signals, order) for order in ("little", "big"))
    length = message.length
    if not big:
        base, places = _put_in(idle, little), {cut.name: cut for cut in little}
        return lambda raw: _replaced(base, places, raw).to_bytes(length, "little")

    def pack(raw: Mapping[str, Raw]) -> bytes:
        every = {**idle, **raw}
        mirrored = _put_in(every, big).to_bytes(length, "big")
        word = _put_in(every, little) | int.from_bytes(mirrored, "little")
        return word.to_bytes(length, "little")

    return pack


def bit_mask(start: int, length: int, *, little: bool) -> int:
    """Return the bits of a signal in its frame, bit 8 n + m for bit m of byte n.

    Args:
        start: First bit as a DBC names it: the highest one of a signal of big-endian order.
        length: Number of bits.
        little: Whether it is of little-endian order.
    """
    if little:
        return ((1 << length) - 1) << start
    bits = 0
    for _ in range(length):
        bits |= 1 << start
        start = start - 1 if start % 8 else start + 15
    return bits


def signal_bits(signal: Signal) -> int:
    """Return the bits of a signal in its frame, as `bit_mask` does."""
    return bit_mask(signal.start, signal.length, little=signal.byte_order == "little_endian")


def is_multiplexed(signal: Signal) -> bool:
    """Return whether only some frames of its message carry a signal."""
    return bool(signal.multiplexer_ids)


def _is_plain(signal: Signal) -> bool:
    return not signal.is_float and not is_multiplexed(signal)


class _Cut(NamedTuple):
    """Position of an integer in the whole frame as one number of its byte order."""

    name: str
    shift: int
    mask: int
    sign: int


def _cuts(message: Message, signals: Iterable[Signal], order: _ByteOrder) -> list[_Cut]:
    chosen = [signal for signal in signals if signal.byte_order == f"{order}_endian"]
    return [_cut(signal, message.length) for signal in chosen]


def _cut(signal: Signal, frame_length: int) -> _Cut:
    shift = signal.start
    if signal.byte_order == "big_endian":
        # a DBC counts bits from the right within a byte, and names the highest bit of the signal
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        shift = 8 * frame_length - first - signal.length
    sign = 1 << (signal.length - 1) if signal.is_signed else 0
    return _Cut(signal.name, shift, (1 << signal.length) - 1, sign)


def _cutter(cuts: Collection[_Cut], order: _ByteOrder) -> Unpack:
    def cut_out(data: bytes) -> dict[str, Raw]:
        word = int.from_bytes(data, order)
        raw: dict[str, Raw] = {}
        for name, shift, mask, sign in cuts:
            # (x ^ sign) - sign extends the sign; an unsigned signal has sign = 0
            raw[name] = ((word >> shift & mask) ^ sign) - sign
        return raw

    return cut_out


def _put_in(raw: Mapping[str, Raw], cuts: Iterable[_Cut]) -> int:
    word = 0
    for name, shift, mask, _ in cuts:
        word |= (cast("int", raw[name]) & mask) << shift
    return word


def _replaced(word: int, places: Mapping[str, _Cut], raw: Mapping[str, Raw]) -> int:
    for name, value in raw.items():
        _, shift, mask, _ = places[name]
        word = word & ~(mask << shift) | (cast("int", value) & mask) << shift
    return word


def _slow_unpack(message: Message, names: frozenset[str]) -> Unpack:
    def unpack(data: bytes) -> dict[str, Raw]:
        decoded = message.decode_simple(data, decode_choices=False, scaling=False)
        return {name: cast("Raw", raw) for name, raw in decoded.items() if name in names}

    return unpack
