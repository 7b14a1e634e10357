"""The command on its way out: which parts of it travel in which frames.

A multiplexed message is sent once for each page that carries something; what several of its pages
carry travels in each of them. A page is a choice of values of the multiplexers. A DBC may give a
signal several of them (`SG_MUL_VAL_`), and a page may have its own multiplexer, whose pages carry
what it carries.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.control.signals import Command
from adaptdrive.hardware.binding import BRIDGE, Sink
from adaptdrive.hardware.dbc.database import Located, SignalCatalogue, is_word
from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.link.layout import initial_value, signal_bits

Page = tuple[tuple[str, float], ...]
"""The multiplexers of a frame, outermost first, and their values."""

_Pages = dict[Page, list[Sink[Located]]]
"""Commanded values of each page of a message."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """One frame that carries a part of the command.

    Attributes:
        codec: Codec of its message; frames of one message share it, and its alive counter.
        parts: What is taken from the command, by signal.
        fixed: Values that are always the same: constants, and what selects the page.
    """

    codec: MessageCodec
    parts: Mapping[str, Sink[Located]]
    fixed: Mapping[str, float]

    def encode(self, command: Command) -> bytes:
        """Make the next frame.

        Raises:
            ValueError: A value is not finite, or its signal cannot hold it.
        """
        values = dict(self.fixed)
        for signal, part in self.parts.items():
            values[signal] = part.value(command)
        return self.codec.encode(values)


def bridge_first(orders: Iterable[CommandFrame]) -> tuple[CommandFrame, ...]:
    """Return frames in their order, those that carry the bridge first: a bus may take one alone."""
    return tuple(
        sorted(orders, key=lambda order: all(one.name != BRIDGE for one in order.parts.values()))
    )


def find_orders(
    catalogue: SignalCatalogue, sinks: Iterable[Sink[Located]], section: str = "signals.command"
) -> dict[str, _Pages]:
    """Return the content of each page of each message; errors go to the catalogue."""
    drafts: dict[str, _Pages] = {}
    for sink in sinks:
        (message, signal), place = sink.item, f"{section}.{sink.name}"
        page = page_of(catalogue, message, signal, place)
        draft = drafts.setdefault(message.name, {}).setdefault(page, [])
        if sink.factor and signal.name in _fixed(draft):
            catalogue.note(place, f"signal {signal.name!r} is a constant too")
        draft.append(sink)
    for name, pages in drafts.items():
        message = catalogue.known(name)
        _check_initial(catalogue, message, pages)
        _check_overlap(catalogue, message, pages)
        _check_pages(catalogue, message, pages)
    return drafts


def build_orders(
    catalogue: SignalCatalogue,
    integrity: Mapping[str, FrameIntegrity],
    drafts: Mapping[str, _Pages],
) -> Iterator[CommandFrame]:
    """The frames of a command, from drafts without a flaw."""
    for name, pages in drafts.items():
        message = catalogue.known(name)
        codec = MessageCodec(message, integrity.get(name))
        parts = [part for draft in pages.values() for part in draft if part.factor]
        for chosen in _frames(pages):
            carried = carried_signals(message, chosen)
            yield CommandFrame(
                codec,
                {one.item.signal.name: one for one in parts if one.item.signal.name in carried},
                {key: value for key, value in chosen.items() if key in carried},
            )


def page_of(catalogue: SignalCatalogue, message: Message, signal: Signal, place: str) -> Page:
    """Return the first page with a signal, empty if all frames have it.

    Args:
        catalogue: Takes the errors.
        message: The message.
        signal: One of its signals.
        place: Where the signal stands in the configuration.
    """
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return ()
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    outer = page_of(catalogue, message, selector, place)
    if not is_word(selector):
        catalogue.note(place, f"its multiplexer {selector.name!r} has a factor or an offset")
    return (*outer, (selector.name, float(signal.multiplexer_ids[0])))


def sent_pages(pages: Iterable[Page]) -> list[Page]:
    """Return the pages that are sent: those of which no other is a part, a single one if all are.

    Args:
        pages: The pages that carry something; each occurs once.
    """
    known = [page for page in pages if page]
    return [
        page
        for page in known
        if not any(len(one) > len(page) and one[: len(page)] == page for one in known)
    ] or [()]


def carried_signals(message: Message, chosen: Mapping[str, float]) -> frozenset[str]:
    """Return the names of the signals in a frame.

    Args:
        message: The message of the frame.
        chosen: Values of its multiplexers; the others have their initial value.
    """
    return frozenset(
        signal.name for signal in message.signals if _is_carried(message, signal, chosen)
    )


def _is_carried(message: Message, signal: Signal, chosen: Mapping[str, float]) -> bool:
    if not signal.multiplexer_ids or signal.multiplexer_signal is None:
        return True
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    value = _selected(selector, chosen)
    return value in signal.multiplexer_ids and _is_carried(message, selector, chosen)


def _selected(selector: Signal, chosen: Mapping[str, float]) -> float:
    return chosen.get(selector.name, initial_value(selector) or 0)


def _fixed(draft: Iterable[Sink[Located]]) -> dict[str, float]:
    """The values among them that are always the same, as their signals hold them."""
    return {
        one.item.signal.name: one.field.physical(one.field.raw(one.base))
        for one in draft
        if not one.factor
    }


def _frames(pages: _Pages) -> Iterator[dict[str, float]]:
    """The values that are always the same, multiplexers among them, of each frame of a message."""
    fixed = _fixed(one for draft in pages.values() for one in draft)
    return ({**fixed, **dict(page)} for page in sent_pages(pages))


def _check_initial(catalogue: SignalCatalogue, message: Message, pages: _Pages) -> None:
    """Each signal can hold its initial value, which it has where nothing else sets it."""
    given = {selector for page in pages for selector, _ in page}
    given |= {one.item.signal.name for draft in pages.values() for one in draft}
    for signal in message.signals:
        if signal.name not in given and initial_value(signal) is None:
            problem = f"initial value (GenSigStartValue) {signal.raw_initial:.12g}"
            bits = f"signal {signal.name!r} of {signal.length} bits cannot hold"
            catalogue.note("signals.command", f"message {message.name!r}: {bits} its {problem}")


def _check_overlap(catalogue: SignalCatalogue, message: Message, pages: _Pages) -> None:
    """No two values that are sent share a bit of their frame."""
    for draft in pages.values():
        bits = {one.item.signal.name: signal_bits(one.item.signal) for one in draft}
        for name, other in combinations(bits, 2):
            if bits[name] & bits[other]:
                problem = f"{other!r} and {name!r} share bits: both are sent"
                catalogue.note("signals.command", f"message {message.name!r}: {problem}")


def _check_pages(catalogue: SignalCatalogue, message: Message, pages: _Pages) -> None:
    """Each frame is of a page that its message has: no other can be encoded."""
    for chosen in _frames(pages):
        for selector in message.signals:
            if not (selector.is_multiplexer and _is_carried(message, selector, chosen)):
                continue
            value = _selected(selector, chosen)
            paged = [one for one in message.signals if one.multiplexer_signal == selector.name]
            if not any(value in (one.multiplexer_ids or ()) for one in paged):
                place = f"signals.command.constants.{message.name}.{selector.name}"
                problem = f"it would be sent as {value:g}, which is none of its pages; name one"
                catalogue.note(place, f"{selector.name!r} is a multiplexer: {problem}")
