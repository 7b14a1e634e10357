"""One message of a DBC in both directions: values to frames, and frames to values or a refusal.

Integers of either byte order are cut out of one big integer by shift and mask. Whatever else a DBC
can describe (floating point and multiplexed signals) takes the slow way through cantools, with the
same results.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from socket import CAN_EFF_FLAG
from types import MappingProxyType
from typing import Final, Literal, cast

import can
from cantools.database import DecodeError
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.devices.can import layout
from adaptdrive.devices.can.integrity import (
    MAX_JUMP,
    AliveCounter,
    FrameVerdict,
    checksum_function,
)
from adaptdrive.devices.field import Field, Raw

_UNPROTECTED = FrameIntegrity()
_GOOD: Final[FrameVerdict] = FrameVerdict.GOOD  # found at once by compiled code
_NOTHING: Final[Mapping[str, float]] = MappingProxyType({})

Unpack = Callable[[bytes], Mapping[str, Raw]]
Pack = Callable[[Mapping[str, Raw]], bytes]
_ByteOrder = Literal["little", "big"]
_Decoded = tuple[FrameVerdict, Mapping[str, float], int]


class MessageCodec:
    """Encodes and decodes the frames of one message, which `key` and `label` identify.

    Each direction keeps its own alive counter. A frame of another length is read if it has the
    bytes that its page needs, for one that wants some signals of a message without counter and
    checksum.
    Build it from a message whose integrity has been checked, as `SignalCatalogue.check_integrity`
    does.
    """

    def __init__(
        self,
        message: Message,
        integrity: FrameIntegrity | None = None,
        fields: Mapping[str, Field] | None = None,
        *,
        cycle_s: float = 0.0,
    ) -> None:
        """Compile a message.

        Args:
            message: The message.
            integrity: Its alive counter and checksum; None for neither.
            fields: How the signals are coded that are decoded and checked; all of them, as the DBC
                has them, when None.
            cycle_s: Time from one frame to the next, 0 for a message of each half cycle.
        """
        integrity = integrity or _UNPROTECTED
        self.name = message.name
        self.frame_id = message.frame_id
        self.is_extended = message.is_extended_frame
        self.is_fd = layout.needs_fd(message)
        self.key = frame_key(message.frame_id, extended=message.is_extended_frame)
        self.label = f"0x{message.frame_id:03X} ({message.name})"
        self.length = message.length
        self._fields = {one.name: layout.compile_field(one) for one in message.signals}
        self._fields.update(fields or {})
        self._prepare_proofs(message, integrity, cycle_s)
        idle = {name: one.idle for name, one in self._fields.items()}
        self._pack = _packer(message, {**idle, **self._fixed})
        self._prepare_decoding(message, fields)

    def _prepare_proofs(self, message: Message, integrity: FrameIntegrity, cycle_s: float) -> None:
        self._counter = integrity.counter
        modulus = layout.counter_modulus(self._fields[self._counter]) if self._counter else 1
        self._modulus = modulus
        self._next = 0
        self._alive = AliveCounter(modulus, min(MAX_JUMP, modulus - 1), cycle_s)
        self._data = b""
        checksum = integrity.checksum
        self._span = layout.checksum_span(message, checksum) if checksum else None
        if self._span is not None:
            self._checksum = checksum_function(integrity, 8 * (self._span[1] - self._span[0]))
        self._proofs = {integrity.counter, integrity.checksum, integrity.nibble}
        data_id = integrity.data_id or 0
        self._fixed = {integrity.nibble: data_id >> 8 & 0xF} if integrity.nibble else {}
        seen = [integrity.counter] if layout.follows_counter(integrity) else []
        seen += [integrity.nibble]
        self._seen = _unpacker(message, filter(None, seen)) if any(seen) else None

    def _prepare_decoding(self, message: Message, fields: Mapping[str, Field] | None) -> None:
        wanted = self._fields if fields is None else fields
        self._wanted = tuple(one for one in wanted.values() if one.name not in self._proofs)
        used = [one.name for one in self._wanted]
        self._unpack = _unpacker(message, [*used, *filter(None, [self._counter])])
        self._is_exact = fields is None or any(self._proofs)
        read = [one for one in message.signals if one.is_multiplexer or one.name in used]
        ends = {one.name: layout.end_of(message, one) for one in read}
        self._paged = {one.name: ends[one.name] for one in read if one.multiplexer_ids}
        in_all = (end for name, end in ends.items() if name not in self._paged)
        self.needed = message.length if self._is_exact else max(in_all, default=0)

    def encode(self, values: Mapping[str, float | None]) -> bytes:
        """Make the next frame; the alive counter advances by one.

        Args:
            values: Physical values by signal, in the units of the DBC; None sends "not available".
                Signals left out are sent as the DBC's initial value.

        Returns:
            The bytes of the frame, with counter and checksum filled in.

        Raises:
            ValueError: A value is not finite, or outside the range of its signal.
            KeyError: The message has no signal of that name.
        """
        raw, counter = {}, self._next
        for name, value in values.items():
            raw[name] = self._fields[name].raw(value)
        if self._counter:
            raw[self._counter] = counter
        data = self._with_checksum(self._pack(raw), counter)
        self._next = (counter + 1) % self._modulus
        return data

    def frame(self, data: bytes) -> can.Message:
        """The frame with some bytes; one of CAN FD carries them at the higher bit rate."""
        return can.Message(
            arbitration_id=self.frame_id,
            is_extended_id=self.is_extended,
            is_fd=self.is_fd,
            bitrate_switch=self.is_fd,
            data=data,
        )

    def decode(self, data: bytes) -> _Decoded:
        """Check a frame: length, checksum, alive counter and ranges, in this order.

        Args:
            data: The bytes of the frame.

        Returns:
            `GOOD`, or the first check that the frame failed; the physical values that are in range
            by signal, in the units of the DBC; and how many frames went missing before this one, as
            far as the alive counter shows. A multiplexed frame gives the values that it carries;
            one that proves nothing, as it is not whole or repeats the last one, gives none.
        """
        size = len(data)
        if size != self.length:
            if self._is_exact or size < self.needed:
                return FrameVerdict.WRONG_LENGTH, _NOTHING, 0
            data = data[: self.length].ljust(self.length, b"\xff")
        if not self._is_whole(data):
            return FrameVerdict.WRONG_CHECKSUM, _NOTHING, 0
        try:
            raw = self._unpack(data)
        except DecodeError:
            return FrameVerdict.OUT_OF_RANGE, _NOTHING, 0
        if size < self.length and size < self._needed_of(raw):
            return FrameVerdict.WRONG_LENGTH, _NOTHING, 0
        verdict, values, lost = self._judge(raw, repeated=data == self._data)
        self._data = data
        if verdict is not _GOOD and not data.strip(b"\xff"):  # nothing is available
            return verdict, _NOTHING, lost
        return verdict, values, lost

    def required(self, data: bytes) -> int:
        """Return the bytes that a frame needs, with what is taken from its page.

        Args:
            data: The bytes of a frame, which may be too short.
        """
        if len(data) < self.needed or not self._paged:
            return self.needed
        return self._needed_of(self._unpack(data[: self.length].ljust(self.length, b"\xff")))

    def carries(self, data: bytes, signal: str) -> bool:
        """Return whether a frame that was decoded has a signal, whatever its value is."""
        return signal in self._unpack(data[: self.length].ljust(self.length, b"\xff"))

    def _needed_of(self, raw: Mapping[str, Raw]) -> int:
        """Return the bytes of a frame that has some signals."""
        return max(self.needed, *(end for name, end in self._paged.items() if name in raw), 0)

    def outside(self, data: bytes) -> str:
        """Return the values of a frame that are out of range, each with its range.

        Args:
            data: The bytes of a frame that was refused for that.
        """
        try:
            raw = self._unpack(data[: self.length].ljust(self.length, b"\xff"))
        except DecodeError:
            return "a page that the DBC does not have"
        found = ((one, raw[one.name]) for one in self._wanted if one.name in raw)
        return ", ".join(
            f"{one.name} = {one.physical(value):g} {one.unit}".rstrip()
            + f" ({one.ends[0]:g}…{one.ends[1]:g})"
            for one, value in found
            if one.value(value) is None
        )

    def resume(self) -> None:
        """Accept any alive counter but the last one: nothing was received for a time."""
        self._alive.resume()

    def _is_whole(self, data: bytes) -> bool:
        span = self._span
        if span is None:
            return True
        first, end, order = span
        covered, held = data[:first] + data[end:], int.from_bytes(data[first:end], order)
        if self._seen is None:
            return held == self._checksum(covered, 0)
        seen = self._seen(data)
        counter = int(seen.get(self._counter or "", 0))
        return held == self._checksum(covered, counter) and all(
            seen[name] == value for name, value in self._fixed.items()
        )

    def _with_checksum(self, data: bytes, counter: int) -> bytes:
        if self._span is None:
            return data
        first, end, order = self._span
        checksum = self._checksum(data[:first] + data[end:], counter)
        return data[:first] + checksum.to_bytes(end - first, order) + data[end:]

    def _judge(self, raw: Mapping[str, Raw], *, repeated: bool) -> _Decoded:
        verdict, lost = self._follow(raw)
        if verdict is FrameVerdict.OUT_OF_RANGE or (verdict is not _GOOD and repeated):
            return verdict, _NOTHING, lost
        values = {}
        for field_ in self._wanted:
            value = raw.get(field_.name)
            if value is None:
                continue
            if field_.low <= value <= field_.high and value not in field_.unknown:
                values[field_.name] = value * field_.scale + field_.offset
            elif verdict is _GOOD:
                verdict = FrameVerdict.OUT_OF_RANGE
        return verdict, values, lost

    def _follow(self, raw: Mapping[str, Raw]) -> tuple[FrameVerdict, int]:
        if not self._counter:
            return _GOOD, 0
        value = int(raw[self._counter])
        if value >= self._modulus:
            return FrameVerdict.OUT_OF_RANGE, 0
        return self._alive.check(value)


def frame_key(frame_id: int, *, extended: bool) -> int:
    """One number for a frame id: an extended id never equals a standard one."""
    return frame_id | CAN_EFF_FLAG if extended else frame_id


# Bits of signals, cut out of a frame and put into one.

_Cut = tuple[str, int, int, int]
"""Name of an integer, its shift and its mask in the whole frame as one number of its byte order,
and its sign bit, 0 where it has none."""


def _unpacker(message: Message, names: Iterable[str]) -> Unpack:
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


def _packer(message: Message, idle: Mapping[str, Raw]) -> Pack:
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
        base, places = _put_in(idle, little), {cut[0]: cut for cut in little}
        return lambda raw: _replaced(base, places, raw).to_bytes(length, "little")

    def pack(raw: Mapping[str, Raw]) -> bytes:
        every = {**idle, **raw}
        mirrored = _put_in(every, big).to_bytes(length, "big")
        word = _put_in(every, little) | int.from_bytes(mirrored, "little")
        return word.to_bytes(length, "little")

    return pack


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
    return signal.name, shift, (1 << signal.length) - 1, sign


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


def _is_plain(signal: Signal) -> bool:
    return not (signal.is_float or signal.multiplexer_ids)
