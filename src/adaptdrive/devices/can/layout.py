"""A DBC's lines and signals: which cannot be used, how a signal is coded, and where its bits are.

Each flaw is a remark with its line. A line that cannot be mended is left out, so that it is an
error only for who names what it describes.
"""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from os.path import commonprefix

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.devices.can.integrity import Span
from adaptdrive.devices.field import Field, Raw, declared_limits, natural_limits, sensible_limits

_CLASSIC_LENGTH = 8
"""Most bytes of a frame without CAN FD."""

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


def signal_bits(signal: Signal) -> int:
    """Return the bits of a signal in its frame, bit 8 n + m for bit m of byte n."""
    if signal.byte_order == "little_endian":
        return ((1 << signal.length) - 1) << signal.start
    bits, at = 0, signal.start  # a DBC names the highest bit
    for _ in range(signal.length):
        bits |= 1 << at
        at = at - 1 if at % 8 else at + 15
    return bits


def end_of(message: Message, signal: Signal) -> int:
    """Return the bytes that a frame needs to have a signal, with what selects its page."""
    end = (signal_bits(signal).bit_length() + 7) // 8
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return end
    return max(end, end_of(message, message.get_signal_by_name(signal.multiplexer_signal)))


def needs_fd(message: Message) -> bool:
    """Return whether the frames of a message are those of CAN FD."""
    return message.is_fd or message.length > _CLASSIC_LENGTH


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
    first = first_bit // 8
    return first, first + signal.length // 8, "little" if little else "big"


# Lines of a DBC that its parser refuses, although nothing may use them.

_UNREAD = re.compile(
    r'^[ \t]*(?:CM_(?=[ \t])[^"\n]*"(?:[^"\\]|\\.)*"[ \t]*;?|BS_[ \t]*:.*$)', re.MULTILINE
)
"""Comments and the bit timing, which nothing uses."""

_MESSAGE = re.compile(r"[ \t]*BO_[ \t]+(\d+)[ \t]+(\w+)[ \t]*:")
_SIGNAL = re.compile(r"[ \t]*SG_[ \t]+(\w+)")
_OF_SIGNAL = re.compile(r"[ \t]*(?:VAL_|SIG_VALTYPE_)[ \t]+(\d+)[ \t]+(\w+)")
_OF_ID = re.compile(
    r"\b(BO_|BO_TX_BU_|SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_)([ \t]+)(\d+)(?![\w.])"
)
_NAMED_BY_DIGIT = re.compile(
    r"^([ \t]*(?:BO_[ \t]+\d+|SG_|(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_)[ \t]+\d+|BA_.*SG_[ \t]+\d+))"
    r"[ \t]+(?=\d+[A-Za-z_])"
)
_BARE_POINT = re.compile(r"(?<=[(,\[|])([ \t]*-?)\.(?=\d)")

_REST = {"BO_": re.compile(r"[ \t]*SG_[ \t]"), "VAL_": re.compile(r'[ \t]*(?:-?\d|"|;)')}
"""Lines that follow a line and belong to it."""

_EXTENDED = 1 << 31
_LARGEST_STANDARD, _LARGEST_ID = 0x7FF, 0x1FFF_FFFF
_WITHOUT_FRAME = "VECTOR__INDEPENDENT_SIG_MSG"
"""Name of the message that holds signals without a frame: the parser leaves it out."""


@dataclass(slots=True)
class MendedText:
    """The text of a DBC for its parser.

    Attributes:
        lines: Its lines.
        remarks: What is wrong in it, each with its line.
        places: Line of each signal, from 1, by the id of its message as written and its name.
    """

    lines: list[str]
    remarks: list[str] = field(default_factory=list)
    places: dict[tuple[str, str], int] = field(default_factory=dict)

    def leave_out(self, number: int, why: str) -> None:
        """Leave out a line, with the signals of a message and further lines of a value table.

        Args:
            number: Its index.
            why: Reason.
        """
        line, self.lines[number] = self.lines[number].strip(), ""
        self.remarks.append(f"line {number + 1}: {line[:60]!r} is left out: {why}")
        rest, following = _REST.get(line.split()[0]), number + 1
        while rest and following < len(self.lines) and rest.match(self.lines[following]):
            self.lines[following] = ""
            following += 1


def mended(text: str) -> MendedText:
    """Return a text in which the parser finds fewer flaws, with remarks on them.

    Args:
        text: Text of a DBC.
    """
    bare = _UNREAD.sub(lambda found: "\n" * found[0].count("\n"), text)
    result = MendedText(bare.split("\n"))
    for number, line in enumerate(result.lines):
        result.lines[number] = _renamed(result, number, _renumbered(result, number, line))
    without_frame = _read_messages(result)
    for number, line in enumerate(result.lines):
        found = _OF_SIGNAL.match(line)
        if found and found[1] == without_frame:
            result.lines[number] = ""
        elif found and (found[1], found[2]) not in result.places:
            result.leave_out(number, f"message {found[1]} has no signal {found[2]!r}")
    return result


def _renumbered(result: MendedText, number: int, line: str) -> str:
    """Return a line whose ids of 29 bits have the mark of such ids."""

    def marked(found: re.Match[str]) -> str:
        frame = int(found[3])
        if not _LARGEST_STANDARD < frame <= _LARGEST_ID:
            return found[0]
        if found[1] == "BO_" and _MESSAGE.match(line):
            remark = f"id {frame:#x} has more than 11 bits, and is taken as one of 29"
            result.remarks.append(f"line {number + 1}: {remark}")
        return f"{found[1]}{found[2]}{frame | _EXTENDED}"

    return _OF_ID.sub(marked, line) if "_" in line else line


def _renamed(result: MendedText, number: int, line: str) -> str:
    """Return a line without names that begin with a digit, and numbers that begin with a point."""
    found = _NAMED_BY_DIGIT.match(line)
    if found:
        line = f"{found[1]} _{line[found.end() :]}"
        result.remarks.append(f"line {number + 1}: a name that begins with a digit")
    return _BARE_POINT.sub(r"\g<1>0.", line) if line.lstrip().startswith("SG_") else line


def _read_messages(result: MendedText) -> str:
    """Note the line of each signal; return the message without a frame, others without go."""
    without_frame = frame = ""
    for number, line in enumerate(result.lines):
        message, found = _MESSAGE.match(line), _SIGNAL.match(line)
        if message:
            frame = message[1]
            if message[2] == _WITHOUT_FRAME:
                without_frame = frame
            elif int(frame) & ~_EXTENDED > _LARGEST_ID:
                result.leave_out(number, f"no frame has the id {int(frame):#x}")
        elif found and result.places.setdefault((frame, found[1]), number + 1) <= number:
            result.remarks.append(f"line {number + 1}: a signal {found[1]!r} is there before")
    return without_frame


# Flaws of a signal of a DBC, and what is probably one.


def signal_problem(message: Message, found: Sequence[Signal]) -> str | None:
    """Return why the signals of one name cannot be used, None where it is one that can."""
    signal = found[0]
    low, high, scale, offset = signal.minimum, signal.maximum, signal.scale, signal.offset
    if len(found) > 1:
        return f"is there {len(found)} times in message {message.name!r}: rename one"
    if signal.start < 0 or signal_bits(signal) >> 8 * message.length:
        return f"does not fit into the {message.length} bytes of message {message.name!r}"
    if not (scale and math.isfinite(scale) and math.isfinite(offset)):
        return f"has factor {scale:g} and offset {offset:g}"
    if low is not None and high is not None and low > high:
        return f"has the range [{low:g}|{high:g}], which ends below its start: state bus.ranges"
    return None
