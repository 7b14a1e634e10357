"""The DBC: loading it, and finding in it what a configuration names."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import cantools
from cantools.database.can.database import Database
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, CanDescription, FrameAddress, FrameIntegrity
from adaptdrive.config.proposals import nearest
from adaptdrive.config.tables import shortened
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.binding import Catalogue, Use
from adaptdrive.hardware.dbc.mending import MendedText, mended
from adaptdrive.hardware.description import description_text, problem_text
from adaptdrive.hardware.field import Field
from adaptdrive.hardware.link.codec import (
    CLASSIC_LENGTH,
    MessageCodec,
    checksum_span,
    counter_modulus,
    follows_counter,
    frame_key,
    needs_fd,
)
from adaptdrive.hardware.link.crc import CHECK_INPUT, crc_function
from adaptdrive.hardware.link.layout import compile_field, is_multiplexed

_FD_LENGTHS = (12, 16, 20, 24, 32, 48, 64)
"""Lengths above eight bytes that a frame of CAN FD can have."""

_NIBBLE_BITS = 4

_UNREADABLE = re.compile(r"Invalid syntax at line (\d+)")
_MOST_LEFT_OUT = 20
"""Lines that cannot be read, of a file that is a DBC nevertheless."""

logging.getLogger("cantools").setLevel(logging.CRITICAL)  # `check` states what matters of a file

_LARGE = re.compile(r"(?<![\w.])[0-9]+(?:(?:\.[0-9]*)?[eE]\+?[0-9]{3,}(?!\w)|(?<=[0-9]{309}))")
"""A number that may be 10^309 or more; the largest that a signal of 64 bits can have is below."""

_PLACE = re.compile(r'\bSG_\s[^:;"]*:\s*(-?[0-9]+)\s*\|\s*(-?[0-9]+)\s*@')
_PAGES = re.compile(r'\bSG_MUL_VAL_\s[^;"]*')
_PAGE_RANGE = re.compile(r"(?<![\w.])(-?[0-9]+)\s*-\s*([0-9]+)(?![\w.])")
_MOST_PAGES = 1 << 17
"""More pages than all multiplexed signals of a file have together: the parser lists each."""

_MOST_BITS = 1 << 16
"""More bits than any message has: those of J1939 in several frames have up to 1785 bytes."""


@dataclass(frozen=True, slots=True)
class Description:
    """Messages and signals that a DBC file describes.

    Attributes:
        database: Its messages and signals.
        remarks: What is wrong in the file, each with its line.
        unfit: What is wrong with a signal that must not be used, by message and signal.
    """

    database: Database
    remarks: Sequence[str]
    unfit: Mapping[tuple[str, str], str]


def read_dbc(path: Path, source: Path | str = "configuration", bus: str = "bus") -> Description:
    """Read a DBC file.

    Args:
        path: The file.
        source: The configuration that names it, for the error message.
        bus: Where the configuration names it.

    Raises:
        ConfigurationError: The file cannot be read or is no DBC.
    """
    try:
        text = description_text(path)
        _refuse_impossible_places(text)
        _refuse_endless_numbers(text)
        _refuse_endless_pages(text)
        whole = mended(text)
        return Description(_parsed(whole), whole.remarks, whole.unfit)
    except Exception as problem:  # the parser's own errors are of many kinds
        flaw = Flaw(f"{bus}.database", f"{path} cannot be used: {problem_text(problem)}")
        raise ConfigurationError(source, [flaw]) from problem


def describe(
    bus: CanDescription, source: Path | str = "configuration", place: str = "bus"
) -> Description:
    """Read the DBC files of a bus, and give its messages the ids that it states.

    Args:
        bus: The bus.
        source: The configuration, for the error message.
        place: Where the bus stands in it.

    Raises:
        ConfigurationError: A file cannot be read, or a message has no such id.
    """
    files = [read_dbc(path, source, place) for path in (bus.database, *bus.databases)]
    messages = [message for one in files for message in one.database.messages]
    flaws = [*_readdressed(messages, bus.frames, f"{place}.frames")]
    if flaws:
        raise ConfigurationError(source, flaws)
    return Description(
        Database(messages, strict=False),
        [remark for one in files for remark in one.remarks],
        {named: remark for one in files for named, remark in one.unfit.items()},
    )


def _readdressed(
    messages: Sequence[Message], frames: Mapping[str, FrameAddress], place: str
) -> Iterator[Flaw]:
    """Change the ids of messages; yield what has no such id."""
    for name, address in frames.items():
        found = [one for one in messages if one.name == name]
        if not found:
            hint = nearest(name, [one.name for one in messages])
            yield Flaw(f"{place}.{name}", f"the database has no message {name!r}{hint}")
        for message in found:
            if message.is_extended_frame:
                message.frame_id = address.of(message.frame_id)
            else:
                yield Flaw(f"{place}.{name}", "an id of 11 bits has no source address")


def load_database(path: Path, source: Path | str = "configuration", bus: str = "bus") -> Database:
    """Read a DBC file, as `read_dbc` does, for its messages alone."""
    return read_dbc(path, source, bus).database


def _parsed(whole: MendedText) -> Database:
    """Return what the parser finds; a line that it cannot read is left out."""
    for _ in range(_MOST_LEFT_OUT):
        try:
            database = cantools.database.load_string(
                whole.text, database_format="dbc", strict=False
            )
        except (cantools.Error, ValueError) as problem:
            line = _UNREADABLE.search(str(problem))
            if line is None or not whole.lines[int(line[1]) - 1].strip():
                raise
            whole.leave_out(int(line[1]) - 1, "it cannot be read")
        else:
            assert isinstance(database, Database)  # noqa: S101 - what the format "dbc" gives
            return database
    raise ValueError(f"more than {_MOST_LEFT_OUT} lines cannot be read; {whole.remarks[-1]}")


def _refuse_endless_numbers(text: str) -> None:
    """Refuse a number whose digits the parser would expand for minutes or hours."""
    for found in _LARGE.finditer(text):
        if math.isinf(float(found[0])):
            line = text.count("\n", 0, found.start()) + 1
            raise ValueError(f"line {line}: {shortened(found[0])} is not the value of any signal")


def _refuse_impossible_places(text: str) -> None:
    """Refuse a signal that no message has room for: billions of bits keep the parser busy."""
    for found in _PLACE.finditer(text):
        start, length = float(found[1]), float(found[2])
        if not (0 <= start < _MOST_BITS and 1 <= length < _MOST_BITS):
            line = text.count("\n", 0, found.start()) + 1
            raise ValueError(f"line {line}: no message has {found[2]} bits from bit {found[1]} on")


def _refuse_endless_pages(text: str) -> None:
    """Refuse a range of pages (values of a multiplexer) that takes all memory to list."""
    pages = 0
    for entry in _PAGES.finditer(text):
        for found in _PAGE_RANGE.finditer(entry[0]):
            pages += max(0, int(found[2]) - int(found[1]) + 1)
            if pages > _MOST_PAGES:
                line = text.count("\n", 0, entry.start() + found.start()) + 1
                shown = f"{shortened(found[1])}-{shortened(found[2])}"
                problem = f"{shown} in SG_MUL_VAL_ makes more than {_MOST_PAGES} pages"
                raise ValueError(f"line {line}: {problem}")


def message_codec(
    database: Database, bus: CanBus, name: str, source: Path | str = "configuration"
) -> MessageCodec:
    """The codec of one message, with the integrity that `[bus.integrity]` gives it.

    Args:
        database: The DBC.
        bus: The configured bus.
        name: The message.
        source: The configuration, for the error message.

    Raises:
        ConfigurationError: The DBC has no such message, or its integrity does not fit it.
    """
    catalogue = SignalCatalogue(Description(database, (), {}), fd=bus.fd)
    message = catalogue.message(name, "bus")
    integrity = bus.integrity.get(name)
    if integrity:
        catalogue.check_integrity(name, integrity)
    if message is None or catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return MessageCodec(message, integrity)


class Located(NamedTuple):
    """A signal and the message that carries it."""

    message: Message
    signal: Signal


class SignalCatalogue(Catalogue[Located]):
    """Finds messages and signals by name, and gathers a flaw for each that is not there."""

    def __init__(
        self,
        description: Description,
        *,
        fd: bool,
        integrity: Mapping[str, FrameIntegrity] = MappingProxyType({}),
    ) -> None:
        super().__init__()
        self._database = description.database
        self._description = description
        self._fd = fd
        self._integrity = integrity

    def field(self, item: Located, use: Use) -> Field:
        """Return how a signal is coded."""
        return compile_field(item.signal, measured=use == "measured", state=use == "state")

    def refusal(self, item: Located, use: Use) -> str | None:
        """Return why a signal cannot be commanded, None where it can or is measured."""
        proof, name = self._integrity.get(item.message.name), item.signal.name
        if use not in {"command", "constant"}:
            return None
        if proof and name in {proof.counter, proof.checksum, proof.nibble}:
            return f"signal {name!r} is the message's counter or checksum"
        if item.signal.is_multiplexer and use == "command":
            return f"signal {name!r} selects what else its frame holds: it cannot be commanded"
        return None

    def count_problem(self, item: Located) -> str | None:
        """Return why a signal cannot count, None where it can."""
        signal = item.signal
        counts = (
            is_word(signal)
            and not signal.is_signed
            and not is_multiplexed(signal)
            and signal.length > 1
            and compile_field(signal).low == 0
        )
        if counts:
            return None
        return (
            f"signal {signal.name!r} cannot count: a counter is an unsigned integer of two bits"
            " or more that starts at 0, has factor 1 and offset 0, and is not multiplexed"
        )

    def check_cycle(self, name: str) -> None:
        """Gather a flaw for a message whose cycle time is a text."""
        cycle: object = self.known(name).cycle_time
        if isinstance(cycle, str):
            problem = f"GenMsgCycleTime {shortened(cycle)!r} is a text, not a number of ms"
            self.note("bus.database", f"message {name!r}: {problem}")

    def known(self, name: str) -> Message:
        """The message called `name`, which has been found before."""
        return self._database.get_message_by_name(name)

    def message(self, name: str, place: str) -> Message | None:
        """The message called `name`, or None and a flaw at `place`."""
        known = {message.name: message for message in self._database.messages}
        message = known.get(name) or known.get(f"_{name}")
        if message is None:
            problem = f"the database has no message {name!r}{nearest(name, known)}"
            self.note(place, f"{problem}{self._remark(name)}")
            return None
        ids = [f"{one.frame_id:#x}" for one in self._database.messages if one.name == name]
        if len(ids) > 1:
            self.note(place, f"message {name!r} is the name of {' and '.join(ids)}: rename one")
        if needs_fd(message) and not self._fd:
            self.note(place, f"message {name!r} is one of CAN FD: it needs bus.fd = true")
            return None
        if message.length > CLASSIC_LENGTH and message.length not in _FD_LENGTHS:
            self.note(place, f"message {name!r} has {message.length} bytes, which no frame has")
            return None
        return message

    def find(self, reference: str, place: str) -> Located | None:
        """The message and signal that `Message.Signal` names, or None and a flaw at `place`."""
        name, dot, signal = reference.partition(".")
        if not (name and dot and signal):
            self.note(place, f"{reference!r} must be written Message.Signal")
            return None
        message = self.message(name, place)
        if message is None:
            return None
        found = self.signal_of(message, signal, place)
        return Located(message, found) if found else None

    def signal_of(self, message: Message, name: str, place: str) -> Signal | None:
        """The signal called `name` of `message`, or None and a flaw at `place`."""
        known = {signal.name: signal for signal in message.signals}
        found = known.get(name) or known.get(f"_{name}")
        if found is None:
            hint = f"{nearest(name, known)}{self._remark(name)}"
            self.note(place, f"message {message.name!r} has no signal {name!r}{hint}")
        self.note(place, self._description.unfit.get((message.name, name)))
        if found is None:
            return None
        low, high = found.minimum, found.maximum
        if not found.scale or not math.isfinite(found.scale) or not math.isfinite(found.offset):
            problem = f"has factor {found.scale:g} and offset {found.offset:g}"
            self.note(place, f"signal {name!r} {problem}")
            return None
        if low is not None and high is not None and low > high:
            problem = f"the range [{low:g}|{high:g}] of signal {name!r} ends below its start"
            self.note(place, problem)
            return None
        return found

    def _remark(self, name: str) -> str:
        """Return what is wrong in the file where it has a name, empty for nothing."""
        named = re.compile(rf"\b{re.escape(name)}\b")
        found = next(filter(named.search, self._description.remarks), "")
        return found and f"; {found}"

    def check_ids(self, measuring: Iterable[str], commanding: Iterable[str], place: str) -> None:
        """Gather a flaw for each used message whose id is that of one with measurements."""
        owners: dict[int, str] = {}
        for name in measuring:
            self._check_id(owners, name, place)
            owners.setdefault(_key(self.known(name)), name)
        for name in commanding:
            self._check_id(owners, name, f"{place}.command")

    def _check_id(self, owners: Mapping[int, str], name: str, place: str) -> None:
        message = self.known(name)
        owner = owners.get(_key(message), name)
        if owner != name:
            number = f"0x{message.frame_id:03X}"
            self.note(place, f"messages {owner!r} and {name!r} have the same id {number}")

    def check_integrity(self, name: str, integrity: FrameIntegrity, bus: str = "bus") -> None:
        """Gather the flaws of `[bus.integrity.NAME]`, of `bus` or of another place."""
        place = f"{bus}.integrity.{name}"
        message = self.message(name, place)
        if message is None:
            return
        if integrity.counter:
            self._check_counter(message, integrity, f"{place}.counter")
        if integrity.checksum:
            self._check_checksum(message, integrity, f"{place}.checksum")
        if integrity.nibble and integrity.data_id_mode == "nibble":
            self._check_nibble(message, integrity.nibble, f"{place}.nibble")
        for key, problem in _form_flaws(message, integrity):
            self.note(f"{place}{key}", problem)

    def _check_nibble(self, message: Message, name: str, place: str) -> None:
        signal = self.signal_of(message, name, place)
        if signal is None:
            return
        plain = is_word(signal) and not signal.is_signed and not is_multiplexed(signal)
        if signal.length != _NIBBLE_BITS or not plain:
            self.note(place, f"signal {name!r} must be four bits of every frame")

    def _check_counter(self, message: Message, integrity: FrameIntegrity, place: str) -> None:
        signal = self.signal_of(message, integrity.counter or "", place)
        problem = None if signal is None else self.count_problem(Located(message, signal))
        if problem:
            self.note(place, problem)
        if signal is None or problem:
            return
        modulus = counter_modulus(compile_field(signal))
        if integrity.max_jump >= modulus:
            problem = f"{integrity.max_jump} must be below the counter's {modulus} values"
            self.note(place.replace(".counter", ".max_jump"), problem)

    def _check_checksum(self, message: Message, integrity: FrameIntegrity, place: str) -> None:
        name, bits = integrity.checksum or "", integrity.crc.width if integrity.crc else 8
        signal = self.signal_of(message, name, place)
        if signal is None:
            return
        span = checksum_span(message, name)
        if span is None or 8 * span.length != bits or is_multiplexed(signal):
            size = {8: "one whole byte", 16: "two whole bytes", 32: "four whole bytes"}[bits]
            problem = f"must fill {size} of every frame"
            self.note(place, f"signal {name!r} {problem}")


def _form_flaws(message: Message, integrity: FrameIntegrity) -> Iterator[tuple[str, str]]:
    """Yield the keys below `[bus.integrity.NAME]` that do not fit each other, and why."""
    crc, mode, algorithm = integrity.crc, integrity.data_id_mode, integrity.algorithm
    has_data_id = mode != "both" or integrity.nibble or integrity.data_id
    if integrity.counter and integrity.counter == integrity.checksum:
        yield "", f"{integrity.counter!r} cannot be both counter and checksum"
    if algorithm != "autosar-p01" and has_data_id:
        yield ".algorithm", f"{algorithm!r} has no data id; 'autosar-p01' has one"
    if follows_counter(integrity) and not integrity.counter:
        yield ".counter", "is missing: the data id of the checksum follows it"
    if (mode == "nibble") != (integrity.nibble is not None):
        yield ".nibble", "is what data_id_mode = 'nibble' needs, and no other mode"
    if (algorithm == "crc") != (crc is not None):
        yield ".crc", "is what algorithm = 'crc' needs, and no other"
    if crc is None:
        return
    if not integrity.checksum:
        yield ".checksum", "is missing: the signal that holds the `crc`"
    if missing := [at for at in crc.covers or () if at >= message.length]:
        length = f"message {message.name!r} has {message.length} bytes, from 0"
        yield ".crc.covers", f"{missing}: {length}"
    found = crc_function(crc)(CHECK_INPUT)
    if crc.check is not None and crc.check != found:
        problem = f"{crc.check:#x} is not what these parameters give, {found:#x}"
        yield ".crc.check", f"{problem}: one of them is copied wrongly"


def cycle_time_s(message: Message) -> float:
    """Return the cycle time of a message in s, 0 without one and for a text."""
    cycle_ms: object = message.cycle_time
    return 1e-3 * cycle_ms if isinstance(cycle_ms, int | float) else 0.0


def _key(message: Message) -> int:
    return frame_key(message.frame_id, extended=message.is_extended_frame)


def is_word(signal: Signal) -> bool:
    """Return whether the physical value of a signal is its raw integer."""
    return not signal.is_float and signal.scale == 1 and signal.offset == 0
