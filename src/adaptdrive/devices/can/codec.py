"""One message of a DBC in both directions: values to frames, and frames to values or a refusal."""

from collections.abc import Collection, Mapping
from socket import CAN_EFF_FLAG
from types import MappingProxyType
from typing import Final

import can
from cantools.database import DecodeError, EncodeError
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.devices.can import layout
from adaptdrive.devices.can.integrity import (
    AliveCounter,
    FrameVerdict,
    Span,
    checksum_function,
    covered_bytes,
)
from adaptdrive.devices.field import Field, Raw

CLASSIC_LENGTH = 8
"""Most bytes of a frame without CAN FD."""

_UNPROTECTED = FrameIntegrity()
_GOOD: Final[FrameVerdict] = FrameVerdict.GOOD  # found at once by compiled code
_NOTHING: Final[Mapping[str, float]] = MappingProxyType({})


class Decoded:
    """Result of decoding a frame.

    A class with its own constructor: compiled code makes one in a tenth of a dataclass's time.

    Attributes:
        verdict: `GOOD`, or the first check that the frame failed.
        values: Physical values by signal that are in range, in the units of the DBC. A multiplexed
            frame gives those that it carries; one that proves nothing, as it is not whole or
            repeats the last one, gives none.
        lost: Frames that went missing before this one, as far as the alive counter shows.
    """

    __slots__ = ("lost", "values", "verdict")

    def __init__(
        self,
        verdict: FrameVerdict,
        values: Mapping[str, float] = _NOTHING,
        lost: int = 0,
    ) -> None:
        self.verdict = verdict
        self.values = values
        self.lost = lost


class MessageCodec:
    """Encodes and decodes the frames of one message, which `key` and `label` tell from others.

    Each direction keeps its own alive counter. A frame of another length is read if it has the
    bytes that its page needs, for one that wants some signals of a message without counter and
    checksum.
    Build it from a message whose integrity has been checked, as `SignalCatalogue.check_integrity`
    does.
    """

    def __init__(  # noqa: PLR0913 - one for each property of a message
        self,
        message: Message,
        integrity: FrameIntegrity | None = None,
        *,
        wanted: Collection[str] | None = None,
        measured: Collection[str] = (),
        states: Mapping[str, float] = _NOTHING,
        cycle_s: float = 0.0,
    ) -> None:
        """Compile a message.

        Args:
            message: The message.
            integrity: Its alive counter and checksum; None for neither.
            wanted: Signals to decode and to check, all of them when None.
            measured: Signals whose largest raw value always means "not available".
            states: Signals of which a value that says that nothing is known is no value, by its
                name or with all its bits set, and the value of each that means on.
            cycle_s: Time from one frame to the next, 0 for a message of each half cycle.
        """
        integrity = integrity or _UNPROTECTED
        self.name = message.name
        self.frame_id = message.frame_id
        self.is_extended = message.is_extended_frame
        self.is_fd = needs_fd(message)
        self.key = frame_key(message.frame_id, extended=message.is_extended_frame)
        self.label = f"0x{message.frame_id:03X} ({message.name})"
        self.length = message.length
        self._fields = {
            signal.name: layout.compile_field(
                signal,
                measured=signal.name in measured,
                state=signal.name in states,
                on=states.get(signal.name),
            )
            for signal in message.signals
        }
        self._prepare_integrity(message, integrity, cycle_s)
        idle = {name: one.idle for name, one in self._fields.items()}
        self._pack = layout.compile_pack(message, {**idle, **self._fixed})
        self._prepare_decoding(message, wanted)

    def _prepare_integrity(
        self, message: Message, integrity: FrameIntegrity, cycle_s: float
    ) -> None:
        self._counter = integrity.counter
        modulus = counter_modulus(self._fields[self._counter]) if self._counter else 1
        self._modulus = modulus
        self._next = 0
        self._alive = AliveCounter(modulus, integrity.max_jump, cycle_s)
        self._data = b""
        self._checksum = checksum_function(integrity)
        self._span = checksum_span(message, integrity.checksum) if integrity.checksum else None
        if self._span is not None:
            self._covered = covered_bytes(integrity, self._span)
        self._proofs = {integrity.counter, integrity.checksum, integrity.nibble}
        self._fixed = {integrity.nibble: integrity.data_id >> 8 & 0xF} if integrity.nibble else {}
        seen = [integrity.counter] if follows_counter(integrity) else []
        seen += [integrity.nibble]
        self._seen = layout.compile_unpack(message, filter(None, seen)) if any(seen) else None

    def _prepare_decoding(self, message: Message, wanted: Collection[str] | None) -> None:
        names = self._fields.keys() if wanted is None else wanted
        self._wanted = tuple(self._fields[name] for name in names if name not in self._proofs)
        used = [one.name for one in self._wanted]
        self._unpack = layout.compile_unpack(message, [*used, *filter(None, [self._counter])])
        self._is_exact = wanted is None or any(self._proofs)
        read = [one for one in message.signals if one.is_multiplexer or one.name in used]
        ends = {one.name: _end_of(message, one) for one in read}
        self._paged = {one.name: ends[one.name] for one in read if layout.is_multiplexed(one)}
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

    def frame(self, data: bytes, *, bitrate_switch: bool = False) -> can.Message:
        """The frame with some bytes.

        Args:
            data: The bytes.
            bitrate_switch: Whether a frame of CAN FD carries them at the higher bit rate.
        """
        return can.Message(
            arbitration_id=self.frame_id,
            is_extended_id=self.is_extended,
            is_fd=self.is_fd,
            bitrate_switch=self.is_fd and bitrate_switch,
            data=data,
        )

    def example(self, values: Mapping[str, float | None] = _NOTHING) -> bytes | None:
        """A frame with every other signal at its initial value, None where that is impossible.

        Args:
            values: As for `encode`.
        """
        try:
            return self.encode(values)
        except (EncodeError, ValueError):  # pages, or a range
            return None

    def decode(self, data: bytes) -> Decoded:
        """Check a frame: length, checksum, alive counter and ranges, in this order.

        Args:
            data: The bytes of the frame.
        """
        size = len(data)
        if size != self.length:
            if self._is_exact or size < self.needed:
                return Decoded(FrameVerdict.WRONG_LENGTH)
            data = data[: self.length].ljust(self.length, b"\xff")
        if not self._is_whole(data):
            return Decoded(FrameVerdict.WRONG_CHECKSUM)
        try:
            raw = self._unpack(data)
        except DecodeError:
            return Decoded(FrameVerdict.OUT_OF_RANGE)
        if size < self.length and size < self._needed_of(raw):
            return Decoded(FrameVerdict.WRONG_LENGTH)
        decoded = self._judge(raw, repeated=data == self._data)
        self._data = data
        if decoded.verdict is not _GOOD and not data.strip(b"\xff"):  # nothing is available
            return Decoded(decoded.verdict, lost=decoded.lost)
        return decoded

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

    def reset(self) -> None:
        """Forget the alive counter received last; the next frame starts anew."""
        self._alive.reset()
        self._data = b""

    def resume(self) -> None:
        """Accept any alive counter but the last one: nothing was received for a time."""
        self._alive.resume()

    def _is_whole(self, data: bytes) -> bool:
        span = self._span
        if span is None:
            return True
        covered, held = self._covered(data), span.read(data)
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
        return self._span.write(data, self._checksum(self._covered(data), counter))

    def _judge(self, raw: Mapping[str, Raw], *, repeated: bool) -> Decoded:
        verdict, lost = self._follow(raw)
        if verdict is FrameVerdict.OUT_OF_RANGE or (verdict is not _GOOD and repeated):
            return Decoded(verdict, lost=lost)
        values = {}
        for field_ in self._wanted:
            value = raw.get(field_.name)
            if value is None:
                continue
            if field_.low <= value <= field_.high and value not in field_.unknown:
                values[field_.name] = value * field_.scale + field_.offset
            elif verdict is _GOOD:
                verdict = FrameVerdict.OUT_OF_RANGE
        return Decoded(verdict, values, lost)

    def _follow(self, raw: Mapping[str, Raw]) -> tuple[FrameVerdict, int]:
        if not self._counter:
            return _GOOD, 0
        value = int(raw[self._counter])
        if value >= self._modulus:
            return FrameVerdict.OUT_OF_RANGE, 0
        return self._alive.check(value)


def _end_of(message: Message, signal: Signal) -> int:
    """Return the bytes that a frame needs to have a signal, with what selects its page."""
    end = (layout.signal_bits(signal).bit_length() + 7) // 8
    if not layout.is_multiplexed(signal) or signal.multiplexer_signal is None:
        return end
    return max(end, _end_of(message, message.get_signal_by_name(signal.multiplexer_signal)))


def frame_key(frame_id: int, *, extended: bool) -> int:
    """One number for a frame id: an extended id never equals a standard one."""
    return frame_id | CAN_EFF_FLAG if extended else frame_id


def needs_fd(message: Message) -> bool:
    """Return whether the frames of a message are those of CAN FD."""
    return message.is_fd or message.length > CLASSIC_LENGTH


def counter_modulus(counter: Field) -> int:
    """Return the modulus of a counter, from the largest value that the DBC declares for it."""
    return int(counter.high) + 1


def follows_counter(integrity: FrameIntegrity) -> bool:
    """Return whether a checksum covers something that goes with the alive counter."""
    by_counter = integrity.crc is not None and bool(integrity.crc.by_counter)
    return by_counter or integrity.data_id_mode == "alternating"


def checksum_span(message: Message, checksum: str) -> Span | None:
    """Return the position of a checksum signal, None when it does not fill whole bytes."""
    signal = message.get_signal_by_name(checksum)
    little = signal.byte_order == "little_endian"
    first_bit = signal.start if little else signal.start - 7
    if signal.length % 8 or first_bit % 8 or signal.is_float:
        return None
    return Span(first_bit // 8, signal.length // 8, "little" if little else "big")
