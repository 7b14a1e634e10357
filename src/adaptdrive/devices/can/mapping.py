"""Mapping of signals to quantities: checks the configuration against its DBC.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config import root
from adaptdrive.config.bus import CanBus, CanDescription, Signals
from adaptdrive.config.timing import Timing
from adaptdrive.devices import binding, description
from adaptdrive.devices.can import database, layout
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.orders import (
    CommandFrame,
    are_apart,
    build_orders,
    check_rates,
    find_copies,
    find_orders,
)
from adaptdrive.devices.faults import FaultWord
from adaptdrive.util.errors import ConfigurationError, Flaw

LONGEST_STALE_S = 10.0
"""Age at which a value is old however seldom its message comes: three cycles of 3.3 s."""


@dataclass(frozen=True, slots=True)
class CanSource:
    """Source of a quantity.

    Attributes:
        quantity: Field of `Reading`; or one of its other values.
        signal: Name of the signal of the DBC.
        scale: SI units per unit of the signal.
        offset: SI value of a zero signal.
        slack_s: How much older than `interlocks.stale_s` its values may be, as their message or
            the clock, with which they are taken, comes less often.
        cycle_by: What says so of the slower of them: GenMsgCycleTime or a key of `[bus]`.
        cycle_s: Time from one such value to the next, infinite where nothing says how often its
            message comes.
        on: Value of the signal while the bridge is on.
    """

    quantity: str
    signal: str
    scale: float
    offset: float
    slack_s: float = 0.0
    cycle_by: str = ""
    cycle_s: float = 0.0
    on: float = 1.0


@dataclass(frozen=True, slots=True)
class StatusFrame:
    """A message that carries measurements, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[CanSource, ...]


@dataclass(frozen=True, slots=True)
class CanMapping:
    """Messages and properties of one drive, for its port.

    Attributes:
        statuses: Messages with measurements.
        orders: Frames of the command, in the order of sending.
        setup: Frames that are sent once, when the bus is opened.
        clock: Message whose arrival is the fast tick.
        page: Signal whose page of that message alone is it, None for all its frames.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
        faults: Watched words of the drive, of faults and warnings.
        others: Names of its values that are no quantity.
        cautions: What can be used, and is probably not meant.
        timing: Times of the drive.
    """

    statuses: tuple[StatusFrame, ...]
    orders: tuple[CommandFrame, ...]
    setup: tuple[CommandFrame, ...]
    clock: str
    page: str | None
    counter_modulus: int | None
    faults: Mapping[str, FaultWord]
    others: tuple[str, ...]
    timing: Timing
    cautions: tuple[Flaw, ...]


_Cycle = tuple[float, str, Message]
"""Time from one frame of a signal to the next, the key or attribute of it, and its message."""


def map_drive(
    bus: CanBus,
    signals: Signals,
    timing: Timing,
    source: Path | str = "configuration",
    demands: description.Demands = description.NO_DEMANDS,
) -> CanMapping:
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
    bound = {one.quantity: one for one in catalogue.sources(signals.entries(), demands)}
    sources: dict[str, list[CanSource]] = {}
    for one in bound.values():
        sources.setdefault(one.item.message.name, []).append(
            _source(catalogue, bus, timing, clock, one)
        )
    sinks = catalogue.sinks(signals.command, demands)
    parts = find_orders(catalogue, [*sinks, *find_copies(catalogue, signals, demands)])
    setup = find_orders(catalogue, catalogue.settings(bus.setup, "bus.setup"), "bus.setup")
    if clock is not None:
        catalogue.note("bus.clock", _clock_problem(bus, sources))
    check_rates(catalogue, bus.send_every_s, parts)
    for message in bus.polled.keys() & {**parts, **setup}:
        catalogue.note(f"bus.polled.{message}", "it carries the command: name one that is read")
    own = [
        name
        for name in setup
        if name not in parts or not are_apart(catalogue.known(name), setup[name], parts[name])
    ]
    catalogue.check_uses({"signals": sources, "signals.command": parts, "bus.setup": own})
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    counter = bound.get("counter")
    commanded = tuple(
        replace(one, every_s=bus.send_every_s.get(one.codec.name, 0.0))
        for one in build_orders(catalogue, bus.integrity, parts)
    )
    codecs = {one.codec.name: one.codec for one in commanded}
    return CanMapping(
        statuses=tuple(
            status_frame(catalogue, bus, *item, database.cycle_time_s(catalogue.known(item[0])))
            for item in sources.items()
        ),
        orders=commanded,
        setup=tuple(build_orders(catalogue, bus.integrity, setup, codecs)),
        clock=bus.clock_message,
        page=bus.clock_signal,
        counter_modulus=None if counter is None else layout.counter_modulus(counter.field),
        faults=binding.watched_words(bound.values()),
        others=binding.other_names(bound.values()),
        timing=timing,
        cautions=tuple(catalogue.cautions),
    )


def _clock_problem(bus: CanBus, sources: Mapping[str, Iterable[CanSource]]) -> str | None:
    """Return that nothing is taken from what clocks, None where something is."""
    signals = (f"{name}.{one.signal}" for name, found in sources.items() for one in found)
    if bus.clock in {*sources, *signals}:
        return None
    what = "signal" if bus.clock_signal else "message"
    return f"no entry of [signals] is taken from {what} {bus.clock!r}"


def _source(
    catalogue: database.SignalCatalogue,
    bus: CanBus,
    timing: Timing,
    clock: Message | None,
    source: description.Source[database.Located],
) -> CanSource:
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
    stated = (
        message.name in {bus.clock_message, *bus.polled} or database.cycle_time_s(message) > 0.0
    )
    return CanSource(
        quantity=source.quantity,
        signal=signal.name,
        scale=source.scale,
        offset=source.offset,
        slack_s=slack_s,
        cycle_by=by,
        cycle_s=cycle_s if stated else math.inf,
        on=1.0 if source.on is None else source.on,
    )


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
    sources: Iterable[CanSource],
    cycle_s: float,
) -> StatusFrame:
    """Return a message that is read.

    Args:
        catalogue: Has the message.
        bus: Its bus.
        name: Its name.
        sources: What is taken from it.
        cycle_s: Time from one of its frames to the next, 0 for a message of each half cycle.
    """
    sources = tuple(sources)
    codec = MessageCodec(
        catalogue.known(name),
        bus.integrity.get(name),
        wanted=dict.fromkeys(source.signal for source in sources),
        measured={source.signal for source in sources if not binding.is_word(source.quantity)},
        states={source.signal: source.on for source in sources if source.quantity == "bridge"},
        cycle_s=cycle_s,
    )
    return StatusFrame(codec, sources)
