"""The command on its way out: which parts of it travel in which frames.

A frame is a choice of values of the multiplexers of its message; which signals it carries follows.
A multiplexed message is sent once for each choice that a signal of the command needs, unless the
choice of another signal includes that. A DBC may give a signal several values (`SG_MUL_VAL_`), and
a multiplexer may be one of the signals that another one selects.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import FrameIntegrity, Signals
from adaptdrive.control.signals import Command
from adaptdrive.devices.binding import BRIDGE, is_word
from adaptdrive.devices.can import database, layout
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.description import NO_DEMANDS, Demands, Sink
from adaptdrive.util.errors import nearest

_NOTHING: Mapping[str, float] = MappingProxyType({})
Choice = dict[str, float]
"""Values of multiplexers by name."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame that carries a part of the command.

    Attributes:
        codec: Codec of its message; frames of one message share it, and its alive counter.
        parts: What is taken from the command, by signal.
        fixed: Values that are always the same: constants, and what selects the page.
        copies: Measured values that are sent back, by signal.
        every_s: Time from one to the next where it does not go with each command.
    """

    codec: MessageCodec
    parts: Mapping[str, Sink[database.Located]]
    fixed: Mapping[str, float]
    copies: Mapping[str, Sink[database.Located]]
    every_s: float = 0.0

    def encode(self, command: Command, measured: Mapping[str, float] = _NOTHING) -> bytes:
        """Make the next frame.

        Args:
            command: The command.
            measured: Measured values by name; a copy of one that is missing, or does not fit into
                its signal, says that it is not available.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it.
        """
        values: dict[str, float | None] = dict(self.fixed)
        for signal, part in self.parts.items():
            values[signal] = part.value(command)
        for signal, copy in self.copies.items():
            value = copy.base + copy.factor * measured.get(copy.name, math.nan)
            values[signal] = None if copy.field.problem(value) else value
        return self.codec.encode(values)


def bridge_first(orders: Iterable[CommandFrame]) -> tuple[CommandFrame, ...]:
    """Return frames in their order, those that carry the bridge first: a bus may take one alone."""
    return tuple(
        sorted(orders, key=lambda order: all(one.name != BRIDGE for one in order.parts.values()))
    )


def find_copies(
    catalogue: database.SignalCatalogue, signals: Signals, demands: Demands = NO_DEMANDS
) -> Iterator[Sink[database.Located]]:
    """Yield the destination of each measured value that is sent back; flaws are collected.

    Args:
        catalogue: Has the signals.
        signals: `[signals]`.
        demands: What the signals must be able to carry.
    """
    known = [name for name, _, _ in signals.entries() if not is_word(name)]
    for name, entry in signals.command.copies.items():
        place, item = f"signals.command.copies.{name}", None
        if name in known:
            item = catalogue.find(entry.signal, place)
        else:
            catalogue.note(place, f"the drive does not send {name!r}{nearest(name, known)}")
        if item is not None:
            catalogue.note(place, catalogue.refusal(item, "command"))
            field = catalogue.field(item, "command")
            catalogue.check_unit(entry, field, demands.unit_of(name), place)
            yield Sink(name, item, field, -entry.offset / entry.scale, 1.0 / entry.scale)


def find_orders(
    catalogue: database.SignalCatalogue,
    sinks: Iterable[Sink[database.Located]],
    section: str = "signals.command",
) -> dict[str, list[Sink[database.Located]]]:
    """Return the values that each message carries; errors go to the catalogue."""
    drafts: dict[str, list[Sink[database.Located]]] = {}
    for sink in sinks:
        drafts.setdefault(sink.item.message.name, []).append(sink)
    for name, draft in drafts.items():
        fixed = _fixed(draft)
        for sink in draft:
            if sink.factor and sink.item.signal.name in fixed:
                problem = f"signal {sink.item.signal.name!r} is a constant too"
                catalogue.note(f"{section}.{sink.name}", problem)
        message = catalogue.known(name)
        for problem in dict.fromkeys(_problems(message, draft)):
            catalogue.note(section, f"message {name!r}: {problem}")
    return drafts


def build_orders(
    catalogue: database.SignalCatalogue,
    integrity: Mapping[str, FrameIntegrity],
    drafts: Mapping[str, Sequence[Sink[database.Located]]],
    codecs: Mapping[str, MessageCodec] = MappingProxyType({}),
) -> Iterator[CommandFrame]:
    """The frames of a command, from drafts without a flaw.

    Args:
        catalogue: Has their messages.
        integrity: Counters and checksums by message.
        drafts: The values that each message carries.
        codecs: Codecs of messages that others send, too.
    """
    for name, draft in drafts.items():
        message = catalogue.known(name)
        codec = codecs.get(name) or MessageCodec(message, integrity.get(name))
        for fixed, carried in _frames(message, draft):
            sent = {one.item.signal.name: one for one in carried if one.factor}
            parts = {name: one for name, one in sent.items() if one.is_commanded}
            copies = {name: one for name, one in sent.items() if name not in parts}
            yield CommandFrame(codec, parts, fixed, copies)


def check_rates(
    catalogue: database.SignalCatalogue,
    rates: Mapping[str, float],
    drafts: Mapping[str, Sequence[Sink[database.Located]]],
) -> None:
    """Collect the messages that cannot have a rate of their own: they carry what is commanded.

    Args:
        catalogue: Collects the flaws.
        rates: `bus.send_every_s`.
        drafts: The values that each message of the command carries.
    """
    for name in rates:
        place = f"bus.send_every_s.{name}"
        commanded = [one for one in drafts.get(name, ()) if one.factor and one.is_commanded]
        if name not in drafts:
            hint = nearest(name, [*drafts])
            catalogue.note(place, f"no message {name!r} goes with the command{hint}")
        elif commanded:
            problem = f"carries {commanded[0].name}, which goes with each command"
            catalogue.note(place, f"message {name!r} {problem}")


def are_apart(
    message: Message,
    setup: Sequence[Sink[database.Located]],
    command: Sequence[Sink[database.Located]],
) -> bool:
    """Return whether no frame of a set-up carries a signal of the command.

    Args:
        message: The message of both.
        setup: What is sent once.
        command: What is sent with each command.
    """
    commanded = [one.item.signal for one in command if not one.item.signal.is_multiplexer]
    return not any(
        is_carried(message, one, fixed) for fixed, _ in _frames(message, setup) for one in commanded
    )


def choices(message: Message, signals: Iterable[Signal]) -> list[Choice]:
    """Return the choice of each frame that it takes to send signals.

    Args:
        message: Their message.
        signals: What is sent.
    """
    found = list[Choice]()
    for choice in (_choice(message, one) for one in signals):
        if choice not in found:
            found.append(choice)
    return [one for one in found if not any(one.items() < other.items() for other in found)]


def _choice(message: Message, signal: Signal) -> Choice:
    """Return the first choice with a signal, empty if all frames have it."""
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return {}
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    return {**_choice(message, selector), selector.name: float(signal.multiplexer_ids[0])}


def is_carried(message: Message, signal: Signal, chosen: Mapping[str, float]) -> bool:
    """Return whether a frame carries a signal.

    Args:
        message: Their message.
        signal: The signal.
        chosen: Values of the multiplexers; the others have their initial value.
    """
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return True
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    value = _selected(selector, chosen)
    return value in signal.multiplexer_ids and is_carried(message, selector, chosen)


def _selected(selector: Signal, chosen: Mapping[str, float]) -> float:
    return chosen.get(selector.name, layout.initial_value(selector) or 0)


def _fixed(draft: Iterable[Sink[database.Located]]) -> dict[str, float]:
    """The values among them that are always the same, as their signals hold them."""
    return {
        one.item.signal.name: one.field.physical(one.field.raw(one.base))
        for one in draft
        if not one.factor
    }


def _frames(
    message: Message, draft: Sequence[Sink[database.Located]]
) -> Iterator[tuple[dict[str, float], list[Sink[database.Located]]]]:
    """The values that are always the same, and all that is carried, of each frame of a message."""
    for choice in choices(message, (one.item.signal for one in draft)):
        chosen = _fixed(draft) | choice
        held = [one.name for one in message.signals if is_carried(message, one, chosen)]
        carried = [one for one in draft if one.item.signal.name in held]
        yield {name: value for name, value in chosen.items() if name in held}, carried


def _problems(message: Message, draft: Sequence[Sink[database.Located]]) -> Iterator[str]:
    """Yield why the frames of a message cannot be sent."""
    given = {one.item.signal.name for one in draft}
    for fixed, carried in _frames(message, draft):
        given.update(fixed)
        bits = {one.item.signal.name: layout.signal_bits(one.item.signal) for one in carried}
        for name, other in combinations(bits, 2):
            if bits[name] & bits[other]:
                yield f"{other!r} and {name!r} share bits: both are sent"
        for selector in message.signals:
            if selector.is_multiplexer and is_carried(message, selector, fixed):
                yield from _selection_problems(message, selector, fixed)
    for signal in message.signals:
        if signal.name not in given and layout.initial_value(signal) is None:
            value = f"initial value (GenSigStartValue) {signal.raw_initial:.12g}"
            yield f"signal {signal.name!r} of {signal.length} bits cannot hold its {value}"


def _selection_problems(
    message: Message, selector: Signal, fixed: Mapping[str, float]
) -> Iterator[str]:
    """Yield why a frame cannot be encoded with the value that its multiplexer has."""
    if selector.name in fixed and not layout.compile_field(selector).is_word:
        yield f"its multiplexer {selector.name!r} has a factor or an offset"
    value = _selected(selector, fixed)
    paged = [one for one in message.signals if one.multiplexer_signal == selector.name]
    if not any(value in (one.multiplexer_ids or ()) for one in paged):
        problem = f"it would be sent as {value:g}, which is none of its pages; name one"
        yield f"{selector.name!r} is a multiplexer: {problem}"
