"""Mapping of signals to quantities: checks the configuration against its DBC.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, Signals, SignalSource, SwitchSource
from adaptdrive.config.supply import VOLTAGE_TICKS
from adaptdrive.config.units import WANTED, unit_problem
from adaptdrive.errors import ConfigurationError
from adaptdrive.hardware.dbc.command_frame import CommandFrame
from adaptdrive.hardware.dbc.database import (
    SignalCatalogue,
    cycle_time_s,
    is_word,
    load_database,
)
from adaptdrive.hardware.dbc.orders import build_orders, find_orders, resolve
from adaptdrive.hardware.demands import NO_DEMANDS, Demands
from adaptdrive.hardware.link.bus import channel_flaws
from adaptdrive.hardware.link.codec import MessageCodec, counter_modulus
from adaptdrive.hardware.link.layout import compile_field, is_multiplexed

_MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
_WORDS = ("counter", "fault", "bridge")
OTHER = "other."

LONGEST_STALE_S = 10.0
"""Age at which a value is old however seldom its message comes: three cycles of 3.3 s."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Settings that determine the maximum age of a value, and the longest stop.

    Attributes:
        half_cycle_s: Half a line cycle.
        stale_s: Oldest usable measurement, `interlocks.stale_s`.
        voltage_parts: Values of which the daemon's voltage loop makes its v_bst, itself among
            them; empty where the drive holds its own.
        stop_s: Longest time that the drive may take for a stop, `interlocks.stop_s`.
    """

    half_cycle_s: float
    stale_s: float
    voltage_parts: frozenset[str]
    stop_s: float = 0.0

    def feeds_voltage_loop(self, quantity: str) -> bool:
        """Return whether a quantity goes into the daemon's voltage loop as v_bst."""
        return quantity.removeprefix(OTHER) in self.voltage_parts


@dataclass(frozen=True, slots=True)
class CanSource:
    """Source of a quantity.

    Attributes:
        quantity: Field of `Reading`; one of its other values by `OTHER` and its name.
        signal: Signal of the DBC.
        scale: SI units per unit of the signal.
        offset: SI value of a zero signal.
        slack_s: How much older than `interlocks.stale_s` its values may be, as their message or
            the clock, with which they are taken, comes less often.
        cycle_by: What says so of the slower of them: GenMsgCycleTime or a key of `[bus]`.
        cycle_s: Time from one such value to the next.
        cycle_stated: Whether something says how often its message comes; else it is taken to come
            as often as the clock.
    """

    quantity: str
    signal: Signal
    scale: float
    offset: float
    slack_s: float
    cycle_by: str
    cycle_s: float
    cycle_stated: bool


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
        clock: Message whose arrival is the fast tick.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
        bridge_on: Value of the signal while the bridge is on.
        fault_names: Value table of the fault word.
        stop_s: Longest time that the drive may take for a stop.
    """

    statuses: tuple[StatusFrame, ...]
    orders: tuple[CommandFrame, ...]
    clock: str
    counter_modulus: int | None
    bridge_on: float
    fault_names: Mapping[int, str]
    stop_s: float


_Sources = dict[str, list[CanSource]]
"""Sources by message."""


def map_drive(
    bus: CanBus,
    signals: Signals,
    timing: Timing,
    source: Path | str = "configuration",
    demands: Demands = NO_DEMANDS,
) -> CanMapping:
    """Find every configured signal in the DBC.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
        timing: How old a value may be.
        source: The configuration, for the error message.
        demands: What the signals must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = SignalCatalogue(load_database(bus.database, source), fd=bus.fd)
    catalogue.flaws.extend(channel_flaws(bus))
    clock = catalogue.message(bus.clock, "bus.clock")
    sources = _find_sources(catalogue, bus, signals, timing, clock)
    bridge_on = _bridge_on(catalogue, signals.bridge, sources)
    _check_units(catalogue, sources, signals, demands.output_unit)
    _check_ranges(catalogue, sources, demands)
    orders = find_orders(catalogue, bus, signals, demands)
    _check_clock(catalogue, clock, sources)
    for name in sources:
        catalogue.check_cycle(name)
    for name, integrity in bus.integrity.items():
        catalogue.check_integrity(name, integrity)
    for message in sources.keys() & orders.keys():
        catalogue.note("signals.command", f"message {message!r} carries measurements too")
    catalogue.check_ids(sources, orders, "signals")
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return CanMapping(
        statuses=tuple(_status(catalogue, bus, *item) for item in sources.items()),
        orders=tuple(build_orders(catalogue, bus, orders)),
        clock=bus.clock,
        counter_modulus=_modulus(sources),
        bridge_on=bridge_on,
        fault_names=_names(sources, "fault"),
        stop_s=timing.stop_s,
    )


def _find_sources(
    catalogue: SignalCatalogue,
    bus: CanBus,
    signals: Signals,
    timing: Timing,
    clock: Message | None,
) -> _Sources:
    found: _Sources = {}
    for quantity, entry in _named(signals):
        place = f"signals.{quantity}"
        hit = catalogue.signal(entry.signal, place)
        if hit is None:
            continue
        message, signal = hit
        cycle = _cycle(message, bus, timing, pages=_pages(message, signal))
        if clock is not None:  # a value is taken with the clock: it waits for that
            cycle = max(cycle, _cycle(clock, bus, timing), key=lambda one: one.cycle_s)
        slack_s = max(0.0, bus.stale_cycles * cycle.cycle_s - timing.stale_s)
        seldom = slack_s > 0.0 or cycle.cycle_s > VOLTAGE_TICKS * timing.half_cycle_s
        if seldom and timing.feeds_voltage_loop(quantity):
            _note_slow(catalogue, cycle.message, place)
        if timing.stale_s + slack_s > LONGEST_STALE_S:
            _note_old(catalogue, cycle.message, place, timing.stale_s + slack_s)
        source = CanSource(
            quantity=quantity,
            signal=signal,
            scale=entry.scale,
            offset=entry.offset,
            slack_s=slack_s,
            cycle_by=cycle.by,
            cycle_s=cycle.cycle_s,
            cycle_stated=message.name == bus.clock or cycle_time_s(message) > 0.0,
        )
        found.setdefault(message.name, []).append(source)
        if quantity in _WORDS:
            _check_word(catalogue, signal, place, plain=(entry.scale, entry.offset) == (1.0, 0.0))
    return found


def _check_units(
    catalogue: SignalCatalogue, sources: _Sources, signals: Signals, output_unit: str
) -> None:
    units = {**WANTED, "output": output_unit}
    for source in (one for found in sources.values() for one in found):
        given = getattr(signals, source.quantity, None)
        if given is not None and source.quantity in units:
            problem = unit_problem(given, source.signal.unit or "", units[source.quantity])
            if problem:
                catalogue.note(f"signals.{source.quantity}", f"{given.signal}: {problem}")


def _check_ranges(catalogue: SignalCatalogue, sources: _Sources, demands: Demands) -> None:
    """Refuse a signal without room above the value that trips: it could never be seen there."""
    for source in (one for found in sources.values() for one in found):
        key, limit = demands.trips.get(source.quantity, ("", -math.inf))
        layout = compile_field(source.signal, measured=True)
        ends = (
            layout.physical(raw) * source.scale + source.offset for raw in (layout.low, layout.high)
        )
        highest = max(ends)
        if highest <= limit:
            problem = f"{source.signal.name} has values up to {highest:g} only"
            catalogue.note(
                f"signals.{source.quantity}",
                f"{problem}: interlocks.{key} = {limit:g} can never trip",
            )


def _named(signals: Signals) -> Iterator[tuple[str, SignalSource]]:
    """Every measured quantity that the drive sends."""
    for quantity in (*_MEASURED, *_WORDS):
        entry: SignalSource | None = getattr(signals, quantity)
        if entry is not None:
            yield quantity, entry
    for name, entry in signals.other.items():
        yield OTHER + name, entry


@dataclass(frozen=True, slots=True)
class _Cycle:
    """Time from one frame of a signal to the next: its message, and what says so."""

    message: Message
    cycle_s: float
    by: str


def _cycle(message: Message, bus: CanBus, timing: Timing, pages: int = 1) -> _Cycle:
    """Return the cycle of a signal that is in one of so many frames of a message."""
    cycle_s = cycle_time_s(message)
    clock_s = bus.clock_ticks * timing.half_cycle_s
    if not cycle_s or (message.name == bus.clock and cycle_s <= clock_s):
        return _Cycle(message, pages * clock_s, "bus.clock_ticks")
    return _Cycle(message, pages * cycle_s, "GenMsgCycleTime")


def _pages(message: Message, signal: Signal) -> int:
    """Return the number of pages of a multiplexed message between two frames of a signal."""
    if not is_multiplexed(signal):
        return 1
    selector = signal.multiplexer_signal
    siblings = [one for one in message.signals if one.multiplexer_signal == selector]
    pages = {page for one in siblings for page in one.multiplexer_ids or ()}
    return len(pages) * _pages(message, message.get_signal_by_name(selector or ""))


def _stated_cycle(message: Message) -> str:
    cycle_ms = message.cycle_time
    return f"GenMsgCycleTime {cycle_ms} ms" if cycle_ms else "no GenMsgCycleTime: that of the clock"


def _note_old(catalogue: SignalCatalogue, message: Message, place: str, limit_s: float) -> None:
    problem = f"bus.stale_cycles lets a value of message {message.name!r}"
    comes = f"({_stated_cycle(message)}) age for {limit_s:.4g} s"
    catalogue.note(place, f"{problem} {comes}, limit {LONGEST_STALE_S:g} s")


def _note_slow(catalogue: SignalCatalogue, message: Message, place: str) -> None:
    problem = f"message {message.name!r} ({_stated_cycle(message)}) comes too seldom"
    catalogue.note(place, f"{problem} for voltage_loop.where = 'daemon'")


def _bridge_on(catalogue: SignalCatalogue, bridge: SwitchSource | None, sources: _Sources) -> float:
    source = _source(sources, "bridge")
    if bridge is None or source is None:
        return 1.0
    given = 1 if bridge.on is None else bridge.on
    value = resolve(catalogue, source.signal, given, "signals.bridge.on")
    if value is None:
        return 1.0
    if is_word(source.signal):
        _check_on(catalogue, source.signal, value)
    return float(value)


def _check_on(catalogue: SignalCatalogue, signal: Signal, value: float) -> None:
    """Refuse a value that no good frame has: every reading would say that the bridge is off."""
    try:
        compile_field(signal, state=True).raw(value)
    except ValueError as problem:
        catalogue.note("signals.bridge.on", f"the bridge would never be on: {problem}")


def _check_word(catalogue: SignalCatalogue, signal: Signal, place: str, *, plain: bool) -> None:
    if not plain:
        catalogue.note(place, "is an integer: it takes no scale and no offset")
    if place == "signals.counter":
        catalogue.check_counter(signal, place)
    elif not is_word(signal):
        problem = f"signal {signal.name!r} must be an integer with factor 1 and offset 0"
        catalogue.note(place, problem)


def _check_clock(catalogue: SignalCatalogue, clock: Message | None, sources: _Sources) -> None:
    if clock is not None and clock.name not in sources:
        problem = f"no entry of [signals] is taken from message {clock.name!r}"
        catalogue.note("bus.clock", problem)


def _status(
    catalogue: SignalCatalogue, bus: CanBus, name: str, sources: Iterable[CanSource]
) -> StatusFrame:
    sources = tuple(sources)
    message = catalogue.known(name)
    codec = MessageCodec(
        message,
        bus.integrity.get(name),
        wanted=dict.fromkeys(source.signal.name for source in sources),
        measured={source.signal.name for source in sources if source.quantity not in _WORDS},
        states={source.signal.name for source in sources if source.quantity == "bridge"},
        cycle_s=cycle_time_s(message),
    )
    return StatusFrame(codec, sources)


def _source(sources: _Sources, quantity: str) -> CanSource | None:
    every = (source for found in sources.values() for source in found)
    return next((source for source in every if source.quantity == quantity), None)


def _modulus(sources: _Sources) -> int | None:
    source = _source(sources, "counter")
    return None if source is None else counter_modulus(compile_field(source.signal))


def _names(sources: _Sources, quantity: str) -> dict[int, str]:
    """The value table of a quantity's signal."""
    source = _source(sources, quantity)
    choices = source.signal.choices if source else None
    return {raw: str(name) for raw, name in (choices or {}).items()}
