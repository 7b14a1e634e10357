"""The command on its way out: which parts of it travel in which frames.

A multiplexed message is sent once for each page that carries something; what several of its pages
carry travels in each of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from adaptdrive.config.bus import FrameIntegrity
from adaptdrive.hardware.binding import Sink
from adaptdrive.hardware.dbc.command_frame import CommandFrame, Part
from adaptdrive.hardware.dbc.database import Located, SignalCatalogue
from adaptdrive.hardware.dbc.pages import Page, absent_pages, carried_signals, page_of, sent_pages
from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.link.layout import bit_mask, initial_value


@dataclass(slots=True)
class _Draft:
    """Commanded signals of one page of a message."""

    parts: list[Part] = field(default_factory=list)
    fixed: dict[str, float] = field(default_factory=dict)


_Drafts = dict[str, dict[Page, _Draft]]


def find_orders(
    catalogue: SignalCatalogue, sinks: Iterable[Sink[Located]], section: str = "signals.command"
) -> _Drafts:
    """Return the content of each page of each message; errors go to the catalogue."""
    drafts: _Drafts = {}
    for sink in sinks:
        (message, signal), place = sink.item, f"{section}.{sink.name}"
        page = page_of(catalogue, message, signal, place)
        draft = drafts.setdefault(message.name, {}).setdefault(page, _Draft())
        if not sink.factor:
            draft.fixed[signal.name] = sink.field.physical(sink.field.raw(sink.base))
            continue
        if signal.name in draft.fixed:
            catalogue.note(place, f"signal {signal.name!r} is a constant too")
        draft.parts.append(Part(sink.name, signal.name, sink.base, sink.factor))
    _check_initial(catalogue, drafts)
    _check_pages(catalogue, drafts)
    _check_overlap(catalogue, drafts)
    return drafts


def build_orders(
    catalogue: SignalCatalogue, integrity: Mapping[str, FrameIntegrity], drafts: _Drafts
) -> Iterator[CommandFrame]:
    """The frames of a command, from drafts without a flaw."""
    for name, pages in drafts.items():
        message = catalogue.known(name)
        codec = MessageCodec(message, integrity.get(name))
        parts = [part for draft in pages.values() for part in draft.parts]
        for chosen in _frames(pages):
            carried = carried_signals(message, chosen)
            yield CommandFrame(
                codec,
                tuple(part for part in parts if part.signal in carried),
                {key: value for key, value in chosen.items() if key in carried},
            )


def _frames(pages: Mapping[Page, _Draft]) -> Iterator[dict[str, float]]:
    """The values that are always the same, multiplexers among them, of each frame of a message."""
    fixed = {key: value for draft in pages.values() for key, value in draft.fixed.items()}
    return ({**fixed, **dict(page)} for page in sent_pages(pages))


def _check_initial(catalogue: SignalCatalogue, drafts: _Drafts) -> None:
    """Each signal can hold its initial value, which it has where nothing else sets it."""
    for name, pages in drafts.items():
        given = {selector for page in pages for selector, _ in page}
        for draft in pages.values():
            given |= {*draft.fixed, *(part.signal for part in draft.parts)}
        for signal in catalogue.known(name).signals:
            if signal.name not in given and initial_value(signal) is None:
                problem = f"initial value (GenSigStartValue) {signal.raw_initial:.12g}"
                bits = f"signal {signal.name!r} of {signal.length} bits cannot hold"
                catalogue.note("signals.command", f"message {name!r}: {bits} its {problem}")


def _check_overlap(catalogue: SignalCatalogue, drafts: _Drafts) -> None:
    """No two values that are sent share a bit of their frame."""
    for name, pages in drafts.items():
        for draft in pages.values():
            taken: dict[str, int] = {}
            for signal in map(
                catalogue.known(name).get_signal_by_name,
                (*draft.fixed, *(part.signal for part in draft.parts)),
            ):
                bits = bit_mask(
                    signal.start, signal.length, little=signal.byte_order == "little_endian"
                )
                for other, others in taken.items():
                    if bits & others and other != signal.name:
                        problem = f"{signal.name!r} and {other!r} share bits: both are sent"
                        catalogue.note("signals.command", f"message {name!r}: {problem}")
                taken[signal.name] = bits


def _check_pages(catalogue: SignalCatalogue, drafts: _Drafts) -> None:
    """Each frame is of a page that its message has: no other can be encoded."""
    for name, pages in drafts.items():
        for chosen in _frames(pages):
            for selector, value in absent_pages(catalogue.known(name), chosen):
                place = f"signals.command.constants.{name}.{selector}"
                problem = f"it would be sent as {value:g}, which is none of its pages; name one"
                catalogue.note(place, f"{selector!r} is a multiplexer: {problem}")
