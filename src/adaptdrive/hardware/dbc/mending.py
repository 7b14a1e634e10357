"""Lines of a DBC that its parser refuses, although nothing may use them.

Each flaw is a remark with its line. A line that cannot be mended is left out, so that it is an
error only for who names what it describes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from adaptdrive.config.tables import shortened
from adaptdrive.hardware.link.layout import bit_mask

_COMMENT = re.compile(r'^[ \t]*CM_(?=[ \t])[^"\n]*"(?:[^"\\]|\\.)*"[ \t]*;?', re.MULTILINE)
_CONTINUED = re.compile(r'^[ \t]*VAL_[ \t][^;\n]*(?:\n[ \t]*(?:-?\d|"|;).*)+', re.MULTILINE)
"""An entry of a value table in several lines: no other line begins with a number or a text."""

_BIT_TIMING = re.compile(r"^[ \t]*BS_[ \t]*:.*$", re.MULTILINE)
_MESSAGE = re.compile(r"[ \t]*BO_[ \t]+(\d+)[ \t]+(\w+)[ \t]*:[ \t]*(\d+)")
_SIGNAL = re.compile(
    r"[ \t]*SG_[ \t]+(\w+)[ \t]*(?:(m\d+M?|M)[ \t]*)?:[ \t]*(\d+)[ \t]*\|[ \t]*(\d+)[ \t]*@([01])"
)
_OF_SIGNAL = re.compile(r"[ \t]*(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_)[ \t]+(\d+)[ \t]+(\w+)")
_OF_ID = re.compile(
    r"\b(BO_|BO_TX_BU_|SG_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|SIG_GROUP_)([ \t]+)(\d+)(?![\w.])"
)
_NAMED_BY_DIGIT = re.compile(
    r"^([ \t]*(?:BO_[ \t]+\d+|SG_|(?:VAL_|SIG_VALTYPE_|SG_MUL_VAL_)[ \t]+\d+|BA_.*SG_[ \t]+\d+))"
    r"[ \t]+(?=\d+[A-Za-z_])"
)
_BARE_POINT = re.compile(r"(?<=[(,\[|])([ \t]*-?)\.(?=\d)")

_LARGE = re.compile(r"(?<![\w.#])[0-9]+(?:(?:\.[0-9]*)?[eE]\+?[0-9]{3,}(?!\w)|(?<=[0-9]{309}))")
"""A number that may be 10^309 or more; the largest that a signal of 64 bits can have is below. A
colour, `#57e389`, is none."""

_PLACE = re.compile(r'\bSG_\s[^:;"]*:\s*(-?[0-9]+)\s*\|\s*(-?[0-9]+)\s*@')
_PAGES = re.compile(r'\bSG_MUL_VAL_\s[^;"]*')
_PAGE_RANGE = re.compile(r"(?<![\w.])(-?[0-9]+)\s*-\s*([0-9]+)(?![\w.])")
_MOST_PAGES = 1 << 17
"""More pages than all multiplexed signals of a file have together: the parser lists each."""

_MOST_BITS = 1 << 16
"""More bits than any message has: those of J1939 in several frames have up to 1785 bytes."""

_EXTENDED = 1 << 31
_LARGEST_STANDARD, _LARGEST_ID = 0x7FF, 0x1FFF_FFFF
_WITHOUT_FRAME = "VECTOR__INDEPENDENT_SIG_MSG"
"""Name of the message that holds signals without a frame."""


@dataclass(slots=True)
class MendedText:
    """The text of a DBC for its parser.

    Attributes:
        lines: Its lines.
        remarks: What is wrong in it, each with its line.
        unfit: What is wrong with a signal that must not be used, by message and signal.
        without_frame: Id of the message that holds signals without a frame.
    """

    lines: list[str]
    remarks: list[str] = field(default_factory=list)
    unfit: dict[tuple[str, str], str] = field(default_factory=dict)
    without_frame: str = ""

    @property
    def text(self) -> str:
        """The lines as one text."""
        return "\n".join(self.lines)

    def leave_out(self, number: int, why: str) -> None:
        """Leave out a line, and the signals of a message with it.

        Args:
            number: Its index.
            why: Reason.
        """
        line, self.lines[number] = self.lines[number].strip(), ""
        self.remarks.append(f"line {number + 1}: {line[:60]!r} is left out: {why}")
        following = number + 1
        while line.startswith("BO_") and following < len(self.lines):
            if not re.match(r"[ \t]*SG_[ \t]", self.lines[following]):
                break
            self.lines[following] = ""
            following += 1


@dataclass(slots=True)
class _Signal:
    name: str
    page: str
    bits: int


def refuse_endless(text: str) -> None:
    """Refuse what keeps the parser busy for hours, or takes all memory.

    Args:
        text: Text of a DBC.

    Raises:
        ValueError: It has such a number, such a signal or such pages, in the line that is named.
    """
    for at, problem in _endless(text):
        raise ValueError(f"line {text.count(chr(10), 0, at) + 1}: {problem}")


def _endless(text: str) -> Iterator[tuple[int, str]]:
    """Yield numbers, signals and values of multiplexers that no message has, and their places."""
    for found in _PLACE.finditer(text):
        if not (0 <= float(found[1]) < _MOST_BITS and 1 <= float(found[2]) < _MOST_BITS):
            yield found.start(), f"no message has {found[2]} bits from bit {found[1]} on"
    for found in _LARGE.finditer(text):
        if math.isinf(float(found[0])):
            yield found.start(), f"{shortened(found[0])} is not the value of any signal"
    pages = 0
    for entry in _PAGES.finditer(text):
        for found in _PAGE_RANGE.finditer(entry[0]):
            pages += max(0, int(found[2]) - int(found[1]) + 1)
            if pages > _MOST_PAGES:
                shown = f"{shortened(found[1])}-{shortened(found[2])}"
                problem = f"{shown} in SG_MUL_VAL_ makes more than {_MOST_PAGES} pages"
                yield entry.start() + found.start(), problem


def mended(text: str) -> MendedText:
    """Return a text in which the parser finds fewer flaws, with remarks on them.

    Args:
        text: Text of a DBC.
    """
    bare = _COMMENT.sub(lambda found: "\n" * found[0].count("\n"), text)
    text = bare if bare.strip() or not text.strip() else 'VERSION ""'
    text = _CONTINUED.sub(_in_one_line, text)
    result = MendedText(_BIT_TIMING.sub("BS_:", text).split("\n"))
    for number, line in enumerate(result.lines):
        result.lines[number] = _renamed(result, number, _renumbered(result, number, line))
    known = {(str(frame), signal.name) for frame, signal in _check_messages(result)}
    for number, line in enumerate(result.lines):
        found = _OF_SIGNAL.match(line)
        if found and found[1] == result.without_frame:
            result.lines[number] = ""
        elif found and (found[1], found[2]) not in known:
            result.leave_out(number, f"message {found[1]} has no signal {found[2]!r}")
    return result


def _in_one_line(found: re.Match[str]) -> str:
    """Return an entry in one line, and an empty line for each other one that it had."""
    return found[0].replace("\n", " ") + "\n" * found[0].count("\n")


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


def _check_messages(result: MendedText) -> Iterator[tuple[int, _Signal]]:
    """Yield the signals of each message, and remark what is wrong with their places."""
    frame, name, length, before = -1, "", 0, list[_Signal]()
    for number, line in enumerate(result.lines):
        message, found = _MESSAGE.match(line), _SIGNAL.match(line)
        if message:
            frame, name, length, before = int(message[1]), message[2], int(message[3]), []
            if name == _WITHOUT_FRAME:
                result.without_frame = message[1]
                frame = -1
            elif frame & ~_EXTENDED > _LARGEST_ID:
                result.leave_out(number, f"no frame has the id {frame:#x}")
                frame = -1
        elif line.lstrip().startswith("BO_ "):
            frame = -1  # the parser leaves it out
        elif found and frame >= 0 and line:
            bits = bit_mask(int(found[3]), int(found[4]), little=found[5] == "1")
            signal = _Signal(found[1], (found[2] or "").rstrip("M"), bits)
            problem = _place_problem(signal, before, length)
            if any(one.name == signal.name for one in before):
                result.leave_out(number, f"message {name!r} has two signals {signal.name!r}")
            elif problem:
                result.remarks.append(f"line {number + 1}: signal {signal.name!r} {problem}")
                if signal.bits >> 8 * length:
                    result.unfit[name, signal.name] = result.remarks[-1]
            before.append(signal)
            yield frame, signal


def _place_problem(signal: _Signal, before: list[_Signal], length: int) -> str | None:
    if signal.bits >> 8 * length:
        return f"does not fit into the {length} bytes of its message"
    other = next(
        (
            one.name
            for one in before
            if one.bits & signal.bits
            and (not one.page or not signal.page or one.page == signal.page)
        ),
        None,
    )
    return f"has bits of {other!r}" if other else None
