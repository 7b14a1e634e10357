"""The command on its way out: which parts of it travel in which frames.

A multiplexed message is sent once for each page that carries something; what several of its pages
carry travels in each of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, CommandSignal, CommandSwitch, Signals
from adaptdrive.config.proposals import nearest
from adaptdrive.config.units import WANTED, unit_problem
from adaptdrive.hardware.dbc.command_frame import CommandFrame, Part
from adaptdrive.hardware.dbc.database import SignalCatalogue
from adaptdrive.hardware.dbc.pages import (
    Page,
    absent_pages,
    carried_signals,
    page_of,
    sent_pages,
)
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.link.codec import MessageCodec
from adaptdrive.hardware.link.layout import compile_field, initial_value

_VALUES = ("current_scale_S", "boost_reference_V")

_ROUNDING = 1e-6
"""Share of one count by which a value may miss its count in binary."""

_PRECISION = 1e-12
"""Share of itself by which a value of more than 40 bits may do so."""


@dataclass(slots=True)
class _Draft:
    """Commanded signals of one page of a message."""

    parts: list[Part] = field(default_factory=list)
    fixed: dict[str, float] = field(default_factory=dict)


_Drafts = dict[str, dict[Page, _Draft]]


def find_orders(
    catalogue: SignalCatalogue, bus: CanBus, signals: Signals, demands: Demands = NO_DEMANDS
) -> _Drafts:
    """Return the content of each page of each message; errors go to the catalogue."""
    drafts: _Drafts = {}
    _find_constants(catalogue, bus, signals, drafts)
    for name in _VALUES:
        given = getattr(signals.command, name)
        if given is not None:
            part = Part(name, "", -given.offset / given.scale, 1.0 / given.scale)
            signal = _add(catalogue, bus, drafts, given.signal, part)
            if signal is not None:
                _check_demands(catalogue, given, signal, part, demands)
    if signals.command.bridge is not None:
        _find_switch(catalogue, bus, signals.command.bridge, drafts)
    _check_initial(catalogue, drafts)
    _check_pages(catalogue, drafts)
    return drafts


def build_orders(
    catalogue: SignalCatalogue, bus: CanBus, drafts: _Drafts
) -> Iterator[CommandFrame]:
    """The frames of a command, from drafts without a flaw."""
    for name, pages in drafts.items():
        message = catalogue.known(name)
        codec = MessageCodec(message, bus.integrity.get(name))
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


def resolve(
    catalogue: SignalCatalogue, signal: Signal, given: float | str, place: str
) -> float | None:
    """Return a value, or the one that a name of the signal's value table stands for."""
    if not isinstance(given, str):
        return given
    names = [(str(name), raw) for raw, name in (signal.choices or {}).items()]
    found = sorted(raw for name, raw in names if name == given)
    if len(found) == 1:
        return compile_field(signal).physical(found[0])
    table = f"the value table of {signal.name!r}"
    if found:
        values = ", ".join(map(str, found))
        catalogue.note(place, f"{table} gives several values the name {given!r}: {values}")
    else:
        hint = nearest(given, [name for name, _ in names])
        catalogue.note(place, f"{table} has no {given!r}{hint}")
    return None


def _find_constants(
    catalogue: SignalCatalogue, bus: CanBus, signals: Signals, drafts: _Drafts
) -> None:
    for reference, given in signals.command.constants.items():
        place = f"signals.command.constants.{reference}"
        hit = catalogue.signal(reference, place)
        if hit is None:
            continue
        message, signal = hit
        value = resolve(catalogue, signal, given, place)
        if value is None:
            continue
        _check_proof(catalogue, bus, message, signal, place)
        if _check_values(catalogue, signal, (value,), place):
            _check_counts(catalogue, signal, (value,), place)
            layout = compile_field(signal)
            draft = _draft(drafts, catalogue, message, signal, place)
            draft.fixed[signal.name] = layout.physical(layout.raw(value))


def _find_switch(
    catalogue: SignalCatalogue, bus: CanBus, switch: CommandSwitch, drafts: _Drafts
) -> None:
    place = "signals.command.bridge"
    hit = catalogue.signal(switch.signal, place)
    if hit is None:
        return
    on = resolve(catalogue, hit[1], 1 if switch.on is None else switch.on, place)
    off = resolve(catalogue, hit[1], 0 if switch.off is None else switch.off, place)
    if on is None or off is None:
        return
    if on == off:
        catalogue.note(place, f"on and off are both {on:g}")
    _add(catalogue, bus, drafts, switch.signal, Part("bridge", "", off, on - off))


def _add(
    catalogue: SignalCatalogue, bus: CanBus, drafts: _Drafts, reference: str, part: Part
) -> Signal | None:
    place = f"signals.command.{part.field}"
    hit = catalogue.signal(reference, place)
    if hit is None:
        return None
    message, signal = hit
    _check_proof(catalogue, bus, message, signal, place)
    if signal.is_multiplexer:
        problem = "selects what else its frame holds: it cannot be commanded"
        catalogue.note(place, f"signal {signal.name!r} {problem}")
    ends = (part.base, part.base + part.factor) if part.field == "bridge" else (part.base,)
    if _check_values(catalogue, signal, ends, place):
        _check_counts(catalogue, signal, ends, place)
    draft = _draft(drafts, catalogue, message, signal, place)
    if signal.name in draft.fixed:
        catalogue.note(place, f"signal {signal.name!r} is a constant too")
    draft.parts.append(Part(part.field, signal.name, part.base, part.factor))
    return signal


def _check_demands(
    catalogue: SignalCatalogue, given: CommandSignal, signal: Signal, part: Part, demands: Demands
) -> None:
    """The signal carries every command within the limits, in the unit of the quantity."""
    place = f"signals.command.{part.field}"
    problem = unit_problem(given, signal.unit or "", WANTED[part.field])
    if problem:
        catalogue.note(place, f"{given.signal}: {problem}")
        return
    for wanted in demands.values(part.field):
        try:
            compile_field(signal).raw(part.base + part.factor * wanted)
        except ValueError as refusal:
            catalogue.note(place, f"cannot carry {wanted:g}, a limit of [drive.limits]: {refusal}")


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


def _check_pages(catalogue: SignalCatalogue, drafts: _Drafts) -> None:
    """Each frame is of a page that its message has: no other can be encoded."""
    for name, pages in drafts.items():
        for chosen in _frames(pages):
            for selector, value in absent_pages(catalogue.known(name), chosen):
                place = f"signals.command.constants.{name}.{selector}"
                problem = f"it would be sent as {value:g}, which is none of its pages; name one"
                catalogue.note(place, f"{selector!r} is a multiplexer: {problem}")


def _check_proof(
    catalogue: SignalCatalogue, bus: CanBus, message: Message, signal: Signal, place: str
) -> None:
    proof = bus.integrity.get(message.name)
    if proof and signal.name in {proof.counter, proof.checksum, proof.nibble}:
        catalogue.note(place, f"signal {signal.name!r} is the message's counter or checksum")


def _check_values(
    catalogue: SignalCatalogue, signal: Signal, values: Iterable[float], place: str
) -> bool:
    try:
        for value in values:
            compile_field(signal).raw(value)
    except ValueError as problem:
        catalogue.note(place, f"the drive could not be switched: {problem}")
        return False
    return True


def _check_counts(
    catalogue: SignalCatalogue, signal: Signal, values: Iterable[float], place: str
) -> None:
    """Each value is sent as it stands, not as that of the nearest count."""
    layout = compile_field(signal)
    rounding = _ROUNDING * abs(layout.scale)
    for value in values:
        sent = layout.physical(layout.raw(value))
        if not math.isclose(sent, value, rel_tol=_PRECISION, abs_tol=rounding):
            problem = f"{signal.name} = {value:.10g} would be sent as {sent:.10g}"
            catalogue.note(place, f"{problem}: its counts are {abs(layout.scale):g} apart")


def _draft(
    drafts: _Drafts, catalogue: SignalCatalogue, message: Message, signal: Signal, place: str
) -> _Draft:
    page = page_of(catalogue, message, signal, place)
    return drafts.setdefault(message.name, {}).setdefault(page, _Draft())
