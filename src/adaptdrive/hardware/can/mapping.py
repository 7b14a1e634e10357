"""Which signal is which quantity: the configuration and its DBC brought together, and checked.

Everything that can be wrong is found here, before a bus is opened, and all of it at once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, Signals, SignalSource
from adaptdrive.errors import ConfigurationError
from adaptdrive.hardware.can.bus import channel_flaws
from adaptdrive.hardware.can.codec import MessageCodec, counter_modulus
from adaptdrive.hardware.can.database import Catalogue, is_multiplexed, is_word, load_database
from adaptdrive.hardware.can.layout import compile_field

_MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
_WORDS = ("counter", "fault", "bridge")
_COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")


@dataclass(frozen=True, slots=True)
class Source:
    """Where a quantity comes from.

    Attributes:
        quantity: Field of `Reading`.
        signal: Signal of the DBC.
        scale: SI units per unit of the signal.
        offset: SI value of a zero signal.
    """

    quantity: str
    signal: Signal
    scale: float
    offset: float


@dataclass(frozen=True, slots=True)
class Status:
    """A message that carries measurements, and what is taken from it."""

    codec: MessageCodec
    sources: tuple[Source, ...]


@dataclass(frozen=True, slots=True)
class Order:
    """A message that carries the command: fields of `Command`, and the signals they go into."""

    codec: MessageCodec
    signals: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class DriveMapping:
    """Everything that the port of one drive needs to know.

    Attributes:
        statuses: Messages with measurements.
        orders: Messages with the command.
        clock: Message whose arrival is the fast tick.
        counter_modulus: Where the half-cycle counter wraps, None for a drive without one.
    """

    statuses: tuple[Status, ...]
    orders: tuple[Order, ...]
    clock: str
    counter_modulus: int | None


def map_drive(bus: CanBus, signals: Signals, source: Path | str = "configuration") -> DriveMapping:
    """Find every configured signal in the DBC.

    Args:
        bus: `[bus]`.
        signals: `[signals]`.
        source: The configuration, for the error message.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    catalogue = Catalogue(load_database(bus.database, source))
    catalogue.flaws.extend(channel_flaws(bus))
    sources = _find_sources(catalogue, signals)
    orders = _find_orders(catalogue, bus, signals)
    _check_clock(catalogue, bus.clock, sources)
    for name, integrity in bus.integrity.items():
        catalogue.check_integrity(name, integrity)
    for message in sources.keys() & orders.keys():
        catalogue.note("signals.command", f"message {message!r} carries measurements too")
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    return DriveMapping(
        statuses=tuple(_status(catalogue, bus, *item) for item in sources.items()),
        orders=tuple(_order(catalogue, bus, *item) for item in orders.items()),
        clock=bus.clock,
        counter_modulus=_modulus(sources),
    )


def _find_sources(catalogue: Catalogue, signals: Signals) -> dict[str, list[Source]]:
    """Sources by message."""
    found: dict[str, list[Source]] = {}
    for quantity in (*_MEASURED, *_WORDS):
        entry: SignalSource | str | None = getattr(signals, quantity)
        if entry is None:
            continue
        place = f"signals.{quantity}"
        reference, scale, offset = _parts(entry)
        hit = catalogue.signal(reference, place)
        if hit is None:
            continue
        message, signal = hit
        found.setdefault(message.name, []).append(Source(quantity, signal, scale, offset))
        if quantity in _WORDS:
            _check_word(catalogue, signal, place, plain=(scale, offset) == (1.0, 0.0))
    return found


def _parts(entry: SignalSource | str) -> tuple[str, float, float]:
    if isinstance(entry, str):
        return entry, 1.0, 0.0
    return entry.signal, entry.scale, entry.offset


def _check_word(catalogue: Catalogue, signal: Signal, place: str, *, plain: bool) -> None:
    if not plain:
        catalogue.note(place, "is an integer: it takes no scale and no offset")
    if place == "signals.counter":
        catalogue.check_counter(signal, place)
    elif not is_word(signal):
        problem = f"signal {signal.name!r} must be an integer with factor 1 and offset 0"
        catalogue.note(place, problem)


def _check_clock(catalogue: Catalogue, clock: str, sources: dict[str, list[Source]]) -> None:
    if catalogue.message(clock, "bus.clock") and clock not in sources:
        catalogue.note("bus.clock", f"no entry of [signals] is taken from message {clock!r}")


def _find_orders(
    catalogue: Catalogue, bus: CanBus, signals: Signals
) -> dict[str, list[tuple[str, str]]]:
    """Fields of `Command` and their signals, by message."""
    found: dict[str, list[tuple[str, str]]] = {}
    for name in _COMMANDED:
        reference: str | None = getattr(signals.command, name)
        if reference is None:
            continue
        place = f"signals.command.{name}"
        hit = catalogue.signal(reference, place)
        if hit is None:
            continue
        message, signal = hit
        found.setdefault(message.name, []).append((name, signal.name))
        _check_commanded(catalogue, bus, message, signal, place)
    return found


def _check_commanded(
    catalogue: Catalogue, bus: CanBus, message: Message, signal: Signal, place: str
) -> None:
    integrity = bus.integrity.get(message.name)
    if integrity and signal.name in {integrity.counter, integrity.checksum}:
        catalogue.note(place, f"signal {signal.name!r} is the message's counter or checksum")
    if is_multiplexed(signal) or signal.is_multiplexer:
        catalogue.note(place, f"signal {signal.name!r} is multiplexed: it cannot be commanded")
    needed = (0, 1) if place.endswith(".bridge") else (0,)
    for value in needed:
        try:
            compile_field(signal).raw(value)
        except ValueError as problem:
            catalogue.note(place, f"the drive could not be switched: {problem}")


def _status(catalogue: Catalogue, bus: CanBus, name: str, sources: Iterable[Source]) -> Status:
    sources = tuple(sources)
    codec = MessageCodec(
        catalogue.known(name),
        bus.integrity.get(name),
        wanted=dict.fromkeys(source.signal.name for source in sources),
        measured={source.signal.name for source in sources if source.quantity in _MEASURED},
    )
    return Status(codec, sources)


def _order(
    catalogue: Catalogue, bus: CanBus, name: str, signals: Iterable[tuple[str, str]]
) -> Order:
    return Order(MessageCodec(catalogue.known(name), bus.integrity.get(name)), tuple(signals))


def _modulus(sources: dict[str, list[Source]]) -> int | None:
    for source in (source for found in sources.values() for source in found):
        if source.quantity == "counter":
            return counter_modulus(compile_field(source.signal))
    return None
