"""The DBC: loading it, and finding in it what a configuration names."""

import logging
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from can.util import CAN_FD_DLC
from cantools.database.can.database import Database
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanDescription, Crc, FrameAddress, FrameIntegrity
from adaptdrive.config.section import Range
from adaptdrive.devices import binding, description
from adaptdrive.devices.can import codec, layout
from adaptdrive.devices.can.bus import channel_flaws
from adaptdrive.devices.field import Field
from adaptdrive.util.errors import ConfigurationError, Flaw, nearest

_NIBBLE_BITS = 4

_UNREADABLE = re.compile(r"Invalid syntax at line (\d+)")
_ENDLESS = re.compile(r"(?<![\w.])-?[\d.]+[eE][+-]?\d{4,}(?!\w)")
"""A number beyond any float: the parser would write a whole one out, digit by digit."""
_MOST_LEFT_OUT = 20
"""Lines that cannot be read, of a file that is a DBC nevertheless."""

_USES = {
    "signals": "carries measurements too",
    "signals.command": "carries the command: name a constant of it",
}
"""Meaning of the places that use a message, for another that does so, too."""

logging.getLogger("cantools").setLevel(logging.CRITICAL)  # `check` states what matters of a file


Description = tuple[Database, list[str]]
"""Messages and signals of a DBC file, and what is wrong in it, each with its line."""


def read_dbc(path: Path, source: Path | str = "configuration", bus: str = "bus") -> Description:
    """Read a DBC file.

    Args:
        path: The file.
        source: The configuration that names it, for the error message.
        bus: Where the configuration names it.

    Raises:
        ConfigurationError: The file cannot be read or is no DBC.
    """
    return description.read_description(path, source, f"{bus}.database", _described)


def describe(
    bus: CanDescription, source: Path | str = "configuration", place: str = "bus"
) -> Description:
    """Read the DBC files of a bus, and give messages their ids and signals their ranges.

    Args:
        bus: The bus.
        source: The configuration, for the error message.
        place: Where the bus stands in it.

    Raises:
        ConfigurationError: A file cannot be read, or a message has no such id.
    """
    files = [read_dbc(path, source, place) for path in bus.database]
    messages = [message for database, _ in files for message in database.messages]
    flaws = [
        *_addressed(messages, bus.frames, f"{place}.frames"),
        *_addressed(messages, bus.polled, f"{place}.polled", "; ask by 'rtr'"),
        *_ranged(messages, bus.ranges, f"{place}.ranges"),
    ]
    if flaws:
        raise ConfigurationError(source, flaws)
    return Database(messages, strict=False), [one for _, remarks in files for one in remarks]


def _addressed(
    messages: Sequence[Message],
    given: Mapping[str, FrameAddress | str],
    place: str,
    remedy: str = "",
) -> Iterator[Flaw]:
    """Change the ids of messages; yield what has no such id, or cannot be asked for so."""
    for name, how in given.items():
        found = [one for one in messages if one.name == name]
        if not found:
            hint = nearest(name, [one.name for one in messages])
            yield Flaw(f"{place}.{name}", f"the database has no message {name!r}{hint}")
        for message in found:
            if how == "rtr" and layout.needs_fd(message):
                yield Flaw(f"{place}.{name}", "'rtr': CAN FD has no remote frames")
            elif how != "rtr" and not message.is_extended_frame:
                problem = "an id of 11 bits has no source address"
                yield Flaw(f"{place}.{name}", f"{problem}{remedy}")
            elif isinstance(how, FrameAddress):
                message.frame_id = how.of(message.frame_id)


def _ranged(messages: Sequence[Message], ranges: Mapping[str, Range], place: str) -> Iterator[Flaw]:
    """Change the ranges of signals; yield what names none."""
    known = {f"{one.name}.{signal.name}": signal for one in messages for signal in one.signals}
    for name, stated in ranges.items():
        if name in known:
            known[name].minimum, known[name].maximum = stated.low, stated.high
        else:
            hint = nearest(name, known)
            yield Flaw(f"{place}.{name}", f"the database has no signal {name!r}{hint}")


def _described(text: str) -> Description:
    """Return what the parser finds; a line that it cannot read is left out."""
    whole = layout.mended(text)
    for index, content in enumerate(whole.lines):
        if endless := _ENDLESS.search(content):
            raise ValueError(f"line {index + 1}: {endless[0]} is too large a number")
    for _ in range(_MOST_LEFT_OUT):
        database = Database(strict=False)
        try:
            database.add_dbc_string("\n".join(whole.lines))
        except Exception as problem:  # parsers raise errors of many kinds
            line = _UNREADABLE.search(str(problem))
            if line is None or not whole.lines[int(line[1]) - 1].strip():
                raise
            whole.leave_out(int(line[1]) - 1, "it cannot be read")
        else:
            remarks = _place_remarks(database.messages, whole.places)
            return database, [*whole.remarks, *remarks]
    raise ValueError(f"more than {_MOST_LEFT_OUT} lines cannot be read; {whole.remarks[-1]}")


Named = TypeVar("Named", Message, Signal)


class Located(NamedTuple):
    """A signal and the message that carries it."""

    message: Message
    signal: Signal


class SignalCatalogue(binding.Catalogue[Located]):
    """Finds messages and signals by name, and gathers a flaw for each that is not there."""

    has_copies = True

    def __init__(
        self,
        database: Database,
        remarks: Sequence[str] = (),
        *,
        fd: bool,
        integrity: Mapping[str, FrameIntegrity] = MappingProxyType({}),
    ) -> None:
        super().__init__(remarks)
        self._database = database
        self._fd = fd
        self._integrity = integrity

    def field(self, item: Located, use: binding.Use) -> Field:
        """Return how a signal is coded."""
        return layout.compile_field(item.signal, measured=use == "measured", state=use == "state")

    def refusal(self, item: Located, use: binding.Use) -> str | None:
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
        if _is_count(signal) and signal.length > 1:
            return None
        return (
            f"signal {signal.name!r} cannot count: a counter is an unsigned integer of two bits"
            " or more that starts at 0, has factor 1 and offset 0, and is not multiplexed"
        )

    def known(self, name: str) -> Message:
        """The message called `name`, which has been found before."""
        return self._database.get_message_by_name(name)

    def message(self, name: str, place: str) -> Message | None:
        """The message called `name`, or None and a flaw at `place`."""
        found = self._named(self._database.messages, name, place, "the database has no message")
        if not found:
            return None
        message, *others = found
        if others:
            ids = " and ".join(f"{one.frame_id:#x}" for one in found)
            self.note(place, f"message {name!r} is the name of {ids}: rename one")
        if layout.needs_fd(message) and not self._fd:
            self.note(place, f"message {name!r} is one of CAN FD: it needs bus.fd = true")
            return None
        if message.length not in CAN_FD_DLC:
            self.note(place, f"message {name!r} has {message.length} bytes, which no frame has")
            return None
        return message

    def find(self, reference: str, place: str) -> Located | None:
        """The message and signal that `Message.Signal` names, or None and a flaw at `place`."""
        name, _, signal = reference.partition(".")
        if not (name and signal):
            self.note(place, f"{reference!r} must be written Message.Signal")
            return None
        message = self.message(name, place)
        if message is None:
            return None
        missing = f"message {message.name!r} has no signal"
        found = self._named(message.signals, signal, place, missing)
        problem = layout.signal_problem(message, found) if found else None
        self.note(place, problem and f"signal {signal!r} {problem}")
        return Located(message, found[0]) if found and not problem else None

    def _named(self, known: Sequence[Named], name: str, place: str, missing: str) -> list[Named]:
        """Return what has a name, or the name with which a digit at its begin was mended."""
        names: list[str] = [one.name for one in known]
        if not {name, f"_{name}"} & {*names}:
            self.note(place, f"{missing} {name!r}{nearest(name, names)}{self.remark(name)}")
        held = name if name in names else f"_{name}"
        return [one for one in known if one.name == held]

    def check_uses(self, uses: Mapping[str, Iterable[str]]) -> None:
        """Gather a flaw for each id that is used twice, at the second place.

        Args:
            uses: Names of messages by the place that uses them.
        """
        owners: dict[int, tuple[str, str]] = {}
        for place, name in ((place, name) for place, names in uses.items() for name in names):
            message = self.known(name)
            key = codec.frame_key(message.frame_id, extended=message.is_extended_frame)
            owner, first = owners.setdefault(key, (name, place))
            if owner != name:
                number = f"0x{message.frame_id:03X}"
                self.note(place, f"messages {owner!r} and {name!r} have the same id {number}")
            elif first != place:
                self.note(place, f"message {name!r} {_USES[first]}")

    def check_integrity(self, name: str, integrity: FrameIntegrity, bus: str = "bus") -> None:
        """Gather the flaws of `[bus.integrity.NAME]`, of `bus` or of another place."""
        place = f"{bus}.integrity.{name}"
        message = self.message(name, place)
        if message is None:
            return
        for key in ("counter", "checksum", "nibble"):
            proof = getattr(integrity, key)
            item = self.find(f"{name}.{proof}", f"{place}.{key}") if proof else None
            if item is None:
                continue
            self.note(f"{place}.{key}", self._proof_problem(key, item, integrity))
        for key, problem in _form_flaws(message, integrity):
            self.note(f"{place}{key}", problem)

    def _proof_problem(self, key: str, item: Located, integrity: FrameIntegrity) -> str | None:
        """Return why a signal is no such proof of a message, None where it is."""
        message, signal = item
        if key == "counter":
            return self.count_problem(item)
        if key == "checksum":
            span = layout.checksum_span(message, signal.name)
            widths = (8, 16, 32) if integrity.crc else (8,)
            fits = span and signal.length in widths and not signal.multiplexer_ids
            size = "one, two or four whole bytes" if integrity.crc else "one whole byte"
            return None if fits else f"signal {signal.name!r} must fill {size} of every frame"
        fits = signal.length == _NIBBLE_BITS and _is_count(signal)
        return None if fits else f"signal {signal.name!r} must be four bits of every frame"


def open_catalogue(bus: CanDescription, source: Path | str, place: str = "bus") -> SignalCatalogue:
    """Return the catalogue of a bus, with what is wrong in its channel and its integrity.

    Args:
        bus: The bus.
        source: The configuration, for the error message.
        place: Where the bus stands in it.

    Raises:
        ConfigurationError: A file cannot be read, or a message has no such id.
    """
    described = describe(bus, source, place)
    catalogue = SignalCatalogue(*described, fd=bus.fd, integrity=bus.integrity)
    catalogue.flaws.extend(channel_flaws(bus, place))
    for name, integrity in bus.integrity.items():
        catalogue.check_integrity(name, integrity, place)
    return catalogue


def _form_flaws(message: Message, integrity: FrameIntegrity) -> Iterator[tuple[str, str]]:
    """Yield the keys below `[bus.integrity.NAME]` that do not fit each other, and why."""
    crc, has_mode = integrity.crc, integrity.data_id_mode != "both"
    if integrity.counter and integrity.counter == integrity.checksum:
        yield "", f"{integrity.counter!r} cannot be both counter and checksum"
    if integrity.data_id is None and (has_mode or integrity.nibble):
        yield ".data_id", "is missing: data_id_mode and nibble need it"
    if has_mode and integrity.nibble:
        yield ".nibble", "needs the mode of its own: leave data_id_mode out"
    if layout.follows_counter(integrity) and not integrity.counter:
        yield ".counter", "is missing: the data id of the checksum follows it"
    if crc is not None:
        yield from _crc_flaws(message, integrity, crc)


def _crc_flaws(message: Message, integrity: FrameIntegrity, crc: Crc) -> Iterator[tuple[str, str]]:
    """Yield the keys that do not fit a checksum by its parameters, and why."""
    if integrity.data_id is not None:
        yield ".data_id", "is that of profile 1, and the form is `crc`: leave one out"
    if not integrity.checksum:
        yield ".checksum", "is missing: the signal that holds the `crc`"
    bits = next((one.length for one in message.signals if one.name == integrity.checksum), 32)
    for name in ("poly", "init", "xorout"):
        if (value := getattr(crc, name)) >> bits:
            yield f".crc.{name}", f"{value:#x} has more than the {bits} bits of the signal"


def _place_remarks(
    messages: Iterable[Message], places: Mapping[tuple[str, str], int]
) -> Iterator[str]:
    """Yield the signals that cannot be used, and those on bits of another one of their frame."""
    for message in messages:
        key = str(codec.frame_key(message.frame_id, extended=message.is_extended_frame))
        before: dict[str, tuple[Signal, int]] = {}
        for signal in message.signals:
            problem = layout.signal_problem(message, [signal])
            bits = 0 if problem else layout.signal_bits(signal)
            shared = (n for n, (one, own) in before.items() if own & bits and _meet(one, signal))
            problem = problem or next((f"has bits of {name!r}" for name in shared), None)
            before[signal.name] = signal, bits
            if problem:
                yield f"line {places.get((key, signal.name), 0)}: signal {signal.name!r} {problem}"


def _meet(one: Signal, other: Signal) -> bool:
    """Return whether a frame may carry two signals: it has no pages, or one has both."""
    pages = one.multiplexer_ids, other.multiplexer_ids
    return not all(pages) or one.multiplexer_ids == other.multiplexer_ids


def cycle_time_s(message: Message) -> float:
    """Return the cycle time of a message in s, 0 without one: a text is none."""
    cycle_ms: object = message.cycle_time
    return 1e-3 * cycle_ms if isinstance(cycle_ms, int | float) else 0.0


def _is_count(signal: Signal) -> bool:
    """Return whether a signal is an integer from 0 on in every frame of its message."""
    field = layout.compile_field(signal)
    return field.is_word and field.low == 0 and not signal.multiplexer_ids
