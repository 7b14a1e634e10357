"""Flaws of a DBC: lines that its parser refuses, and signals that are probably something else.

Each flaw is a remark with its line. A line that cannot be mended is left out, so that it is an
error only for who names what it describes.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.devices.can.layout import signal_bits

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


def sign_caution(signal: Signal) -> str | None:
    """Return that a range begins below what an unsigned signal can be, None where it does not.

    Args:
        signal: A signal without a problem.
    """
    low, high, scale = signal.minimum, signal.maximum, signal.scale
    if signal.is_signed or signal.is_float or low is None or high is None or not (low or high):
        return None
    first = min((end - signal.offset) / scale for end in (low, high))
    if not -math.inf < first <= -1.0:
        return None
    top = (1 << signal.length) - 1
    one, read = (raw * scale + signal.offset for raw in (-1, top))
    unit = f" {signal.unit}" if signal.unit else ""
    meant = f"has the range [{low:g}|{high:g}], and is unsigned: {one:g}{unit} would be read as"
    return f"{meant} {read:g}{unit}; is it signed (@1-, @0-) in the manual of the device?"
