"""Mapping of signals to quantities: checks the configuration against its DBC.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.

A frame of the command is a choice of values of the multiplexers of its message; which signals it
carries follows. A multiplexed message is sent once for each choice that a signal of the command
needs, unless the choice of another signal includes that. A DBC may give a signal several values
(`SG_MUL_VAL_`), and a multiplexer may be one of the signals that another one selects.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import MappingProxyType

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config import root
from adaptdrive.config.bus import CanBus, CanDescription, FrameIntegrity, Signals
from adaptdrive.devices import binding, description
from adaptdrive.devices.can import assembly, database, layout
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.field import Field
from adaptdrive.safety.timing import Timing
from adaptdrive.util.errors import ConfigurationError, nearest

LONGEST_STALE_S = 10.0
"""Age at which a value is old however seldom its message comes: three cycles of 3.3 s."""


_Source = description.Source[database.Located]
_Part = description.Sink[database.Located]

_Cycle = tuple[float, str, Message]
"""Time from one frame of a signal to the next, the key or attribute of it, and its message."""


def map_drive(
    bus: CanBus,
    signals: Signals,
    timing: Timing,
    source: Path | str = "configuration",
    demands: description.Demands = description.NO_DEMANDS,
) -> assembly.CanMapping:
    """Find every configured signal in the DBC.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
        timing: Times of the drive.
        source: The configuration, for the error message.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = database.open_catalogue(bus, source)
    catalogue.warn_of_file("bus.database")
    clock = catalogue.message(bus.clock_message, "bus.clock")
    if clock is not None and bus.clock_signal and not catalogue.find(bus.clock, "bus.clock"):
        clock = None
    found = catalogue.sources(signals.entries(), demands)
    bound = [_source(catalogue, bus, timing, clock, one) for one in found]
    sources: dict[str, list[_Source]] = {}
    for one in bound:
        sources.setdefault(one.item.message.name, []).append(one)
    sinks = catalogue.sinks(signals.command, demands)
    parts = find_orders(catalogue, [*sinks, *_copies(catalogue, signals, demands)])
    setup = find_orders(catalogue, catalogue.settings(bus.setup, "bus.setup"), "bus.setup")
    if clock is not None:
        catalogue.note("bus.clock", _clock_problem(bus, sources))
    _check_rates(catalogue, bus.send_every_s, parts)
    for message in bus.polled.keys() & {**parts, **setup}:
        catalogue.note(f"bus.polled.{message}", "it carries the command: name one that is read")
    own = [
        name
        for name in setup
        if name not in parts or not _are_apart(catalogue.known(name), setup[name], parts[name])
    ]
    catalogue.check_uses({"signals": sources, "signals.command": parts, "bus.setup": own})
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    counter = next((one for one in bound if one.quantity == "counter"), None)
    commanded = tuple(
        replace(one, every_s=bus.send_every_s.get(one.codec.name, 0.0))
        for one in build_orders(catalogue, bus.integrity, parts)
    )
    codecs = {one.codec.name: one.codec for one in commanded}
    return assembly.CanMapping(
        sources=tuple(bound),
        statuses=tuple(
            status_frame(catalogue, bus, *item, database.cycle_time_s(catalogue.known(item[0])))
            for item in sources.items()
        ),
        orders=commanded,
        setup=tuple(build_orders(catalogue, bus.integrity, setup, codecs)),
        clock=bus.clock_message,
        page=bus.clock_signal,
        counter_modulus=None if counter is None else layout.counter_modulus(counter.field),
        timing=timing,
        cautions=tuple(catalogue.cautions),
    )


def _clock_problem(bus: CanBus, sources: Mapping[str, Iterable[_Source]]) -> str | None:
    """Return that nothing is taken from what clocks, None where something is."""
    signals = (f"{name}.{one.field.name}" for name, found in sources.items() for one in found)
    if bus.clock in {*sources, *signals}:
        return None
    what = "signal" if bus.clock_signal else "message"
    return f"no entry of [signals] is taken from {what} {bus.clock!r}"


def _source(
    catalogue: database.SignalCatalogue,
    bus: CanBus,
    timing: Timing,
    clock: Message | None,
    source: _Source,
) -> _Source:
    message, signal = source.item
    cycle = _cycle(message, bus, timing, pages=_pages(message, signal))
    if clock is not None:  # a value is taken with the clock: it waits for that
        cycle = max(cycle, _cycle(clock, bus, timing), key=lambda one: one[0])
    cycle_s, by, slowest = cycle
    slack_s = max(0.0, bus.stale_cycles * cycle_s - timing.stale_s)
    named = f"message {slowest.name!r} ({by}: every {cycle_s * 1e3:.4g} ms)"
    seldom = slack_s > 0.0 or cycle_s > root.VOLTAGE_TICKS * timing.half_cycle_s
    if seldom and source.quantity in timing.voltage_parts:
        problem = f"{named} comes too seldom for voltage_loop.where = 'daemon'"
        catalogue.note(source.place, problem)
    if timing.stale_s + slack_s > LONGEST_STALE_S:
        age = f"age for {timing.stale_s + slack_s:.4g} s, limit {LONGEST_STALE_S:g} s"
        catalogue.note(source.place, f"bus.stale_cycles lets a value of {named} {age}")
    stated = message.name in {bus.clock_message, *bus.polled} or database.cycle_time_s(message) > 0
    cycle_s = cycle_s if stated else math.inf
    return replace(source, slack_s=slack_s, cycle_by=by, cycle_s=cycle_s)


def _cycle(message: Message, bus: CanBus, timing: Timing, pages: int = 1) -> _Cycle:
    """Return the cycle of a signal that is in one of so many frames of a message."""
    cycle_s = database.cycle_time_s(message)
    clock_s = bus.clock_ticks * timing.half_cycle_s
    clocks = message.name == bus.clock_message
    page = next((one for one in message.signals if one.name == bus.clock_signal), None)
    if clocks and page is not None:  # one comes each tick, a page within a page less often
        return max(1, pages // _pages(message, page)) * clock_s, "bus.clock_ticks", message
    if not cycle_s or (clocks and cycle_s <= clock_s):
        return pages * clock_s, "bus.clock_ticks", message
    return pages * cycle_s, "GenMsgCycleTime", message


def _pages(message: Message, signal: Signal) -> int:
    """Return the number of pages of a multiplexed message between two frames of a signal."""
    if not signal.multiplexer_ids:
        return 1
    selector = signal.multiplexer_signal
    siblings = [one for one in message.signals if one.multiplexer_signal == selector]
    pages = {page for one in siblings for page in one.multiplexer_ids or ()}
    return len(pages) * _pages(message, message.get_signal_by_name(selector or ""))


def status_frame(
    catalogue: database.SignalCatalogue,
    bus: CanDescription,
    name: str,
    sources: Iterable[_Source],
    cycle_s: float,
) -> assembly.StatusFrame:
    """Return a message that is read.

    Args:
        catalogue: Has the message.
        bus: Its bus.
        name: Its name.
        sources: What is taken from it.
        cycle_s: Time from one of its frames to the next, 0 for a message of each half cycle.
    """
    sources, fields = tuple(sources), dict[str, Field]()
    for one in sources:
        coded, signal = one.field, one.item.signal
        if one.quantity == binding.BRIDGE:
            coded = layout.compile_field(signal, state=True, on=one.on)
        fields[signal.name] = coded.within(fields.get(signal.name, coded))
    integrity = bus.integrity.get(name)
    codec = MessageCodec(catalogue.known(name), integrity, fields, cycle_s=cycle_s)
    return assembly.StatusFrame(codec, sources)


# The command on its way out: which parts of it travel in which frames.

Choice = dict[str, float]
"""Values of multiplexers by name."""


def _copies(
    catalogue: database.SignalCatalogue, signals: Signals, demands: description.Demands
) -> Iterator[_Part]:
    """Yield the destination of each measured value that is sent back; flaws are collected."""
    known = [name for name, _, _ in signals.entries() if not description.is_word(name)]
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
            base, factor = -entry.offset / entry.scale, 1.0 / entry.scale
            yield description.Sink(name, item, field, base, factor)


def find_orders(
    catalogue: database.SignalCatalogue, sinks: Iterable[_Part], section: str = "signals.command"
) -> dict[str, list[_Part]]:
    """Return the values that each message carries; errors go to the catalogue."""
    drafts: dict[str, list[_Part]] = {}
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
    drafts: Mapping[str, Sequence[_Part]],
    codecs: Mapping[str, MessageCodec] = MappingProxyType({}),
) -> Iterator[assembly.CommandFrame]:
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
            yield assembly.CommandFrame(codec, parts, fixed, copies)


def _check_rates(
    catalogue: database.SignalCatalogue,
    rates: Mapping[str, float],
    drafts: Mapping[str, Sequence[_Part]],
) -> None:
    """Collect the messages that cannot have a rate of their own: they carry what is commanded."""
    for name in rates:
        place = f"bus.send_every_s.{name}"
        commanded = [one for one in drafts.get(name, ()) if one.factor and one.is_commanded]
        if name not in drafts:
            hint = nearest(name, [*drafts])
            catalogue.note(place, f"no message {name!r} goes with the command{hint}")
        elif commanded:
            problem = f"carries {commanded[0].name}, which goes with each command"
            catalogue.note(place, f"message {name!r} {problem}")


def _are_apart(message: Message, setup: Sequence[_Part], command: Sequence[_Part]) -> bool:
    """Return whether no frame of a set-up carries a signal of the command."""
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


def _fixed(draft: Iterable[_Part]) -> dict[str, float]:
    """The values among them that are always the same, as their signals hold them."""
    return {
        one.item.signal.name: one.field.physical(one.field.raw(one.base))
        for one in draft
        if not one.factor
    }


def _frames(
    message: Message, draft: Sequence[_Part]
) -> Iterator[tuple[dict[str, float], list[_Part]]]:
    """The values that are always the same, and all that is carried, of each frame of a message."""
    for choice in choices(message, (one.item.signal for one in draft)):
        chosen = _fixed(draft) | choice
        held = [one.name for one in message.signals if is_carried(message, one, chosen)]
        carried = [one for one in draft if one.item.signal.name in held]
        yield {name: value for name, value in chosen.items() if name in held}, carried


def _problems(message: Message, draft: Sequence[_Part]) -> Iterator[str]:
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
                yield from _page_problems(message, selector, fixed)
    for signal in message.signals:
        if signal.name not in given and layout.initial_value(signal) is None:
            value = f"initial value (GenSigStartValue) {signal.raw_initial:.12g}"
            yield f"signal {signal.name!r} of {signal.length} bits cannot hold its {value}"


def _page_problems(message: Message, selector: Signal, fixed: Mapping[str, float]) -> Iterator[str]:
    """Yield why a frame cannot be encoded with the value that its multiplexer has."""
    if selector.name in fixed and not layout.compile_field(selector).is_word:
        yield f"its multiplexer {selector.name!r} has a factor or an offset"
    value = _selected(selector, fixed)
    paged = [one for one in message.signals if one.multiplexer_signal == selector.name]
    if not any(value in (one.multiplexer_ids or ()) for one in paged):
        problem = f"it would be sent as {value:g}, which is none of its pages; name one"
        yield f"{selector.name!r} is a multiplexer: {problem}"
