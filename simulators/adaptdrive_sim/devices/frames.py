"""Mapping of the simulated drive's quantities to signals and messages.

The drive reads the same configuration as the daemon, from the other side: what is measured there
is sent here, and what is commanded there is obeyed here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, SignalSource, SwitchSource
from adaptdrive.config.root import Configuration
from adaptdrive.devices.can.codec import MessageCodec, counter_modulus
from adaptdrive.devices.can.database import SignalCatalogue, cycle_time_s, open_catalogue
from adaptdrive.devices.can.layout import compile_field
from adaptdrive.devices.can.orders import (
    CommandFrame,
    build_orders,
    choices,
    find_orders,
    is_carried,
)
from adaptdrive.devices.description import demands_of
from adaptdrive.util.errors import ConfigurationError
from adaptdrive_sim.devices.drive import Frame

LOAD_CURRENT = "LoadCurrent"
"""Sent where the database has such a signal; no configuration needs it."""

QUANTITIES = (
    "boost_voltage_V",
    "line_voltage_V",
    "load_power_W",
    "output",
    "counter",
    "fault",
    "bridge",
)


@dataclass(frozen=True, slots=True)
class SignalSink:
    """One quantity on its way into a signal.

    Attributes:
        quantity: Name of the quantity.
        signal: Name of the signal.
        scale: SI units per unit of the signal.
        offset: SI value of a zero signal.
        low: Smallest value that the signal carries.
        high: Largest value that the signal carries.
        modulus: Where a counter wraps, 0 for a quantity that does not.
    """

    quantity: str
    signal: str
    scale: float
    offset: float
    low: float
    high: float
    modulus: int

    def value(self, quantities: Mapping[str, float]) -> float:
        """The signal's value; like a converter's, it ends at the signal's range."""
        value = (quantities[self.quantity] - self.offset) / self.scale
        if self.modulus:
            return value % self.modulus
        return min(max(value, self.low), self.high)


@dataclass(frozen=True, slots=True)
class Page:
    """Contents of one frame of a message; a message that is not multiplexed has one page."""

    selectors: Mapping[str, float]
    sinks: tuple[SignalSink, ...]


@dataclass(frozen=True, slots=True)
class StatusMessage:
    """One message that the drive sends.

    Attributes:
        codec: Its codec.
        pages: Its pages, which take turns.
        every_ticks: Half cycles from one frame to the next.
    """

    codec: MessageCodec
    pages: tuple[Page, ...]
    every_ticks: int

    def number(self, tick: int) -> int:
        """Return the number of frames due by the end of a half cycle."""
        return tick // self.every_ticks

    def encode(self, number: int, quantities: Mapping[str, float]) -> bytes:
        """Make the frame of a number."""
        page = self.pages[number % len(self.pages)]
        values = {sink.signal: sink.value(quantities) for sink in page.sinks}
        return self.codec.encode({**page.selectors, **values})


@dataclass(frozen=True, slots=True)
class DriveMessages:
    """All messages that the drive sends and receives.

    Attributes:
        status: Messages in the order of sending, the clocking one last.
        orders: The frames that it obeys, as the daemon sends them.
    """

    status: tuple[StatusMessage, ...]
    orders: tuple[CommandFrame, ...]

    @property
    def codecs(self) -> tuple[MessageCodec, ...]:
        """One codec for each message that it obeys."""
        return tuple(dict.fromkeys(order.codec for order in self.orders))


def quantities_of(frame: Frame) -> dict[str, float]:
    """Return a frame's quantities by name."""
    sample = frame.sample
    return {
        "boost_voltage_V": sample.boost_voltage_V,
        "line_voltage_V": sample.line_voltage_V,
        "load_power_W": sample.load_power_W,
        "output": sample.output,
        "counter": sample.tick,
        "fault": frame.fault,
        "bridge": frame.bridge,
        "load_current_A": sample.load_current_A,
    }


def load_messages(bus: CanBus, configuration: Configuration, source: Path) -> DriveMessages:
    """Find the drive's messages in the configured database.

    Args:
        bus: The configuration's bus.
        configuration: The drive's configuration.
        source: Its file, for the error message.

    Raises:
        ConfigurationError: The database and the configuration do not fit together.
    """
    catalogue = open_catalogue(bus, source)
    sinks = _find_sinks(catalogue, configuration)
    sent = catalogue.sinks(configuration.signals.command, demands_of(configuration))
    orders = find_orders(catalogue, sent)
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    half_cycle_ms = 500.0 / configuration.drive.line_frequency_Hz
    names = sorted(sinks, key=lambda name: (name == bus.clock_message, name))
    return DriveMessages(
        tuple(
            StatusMessage(
                MessageCodec(catalogue.known(name), bus.integrity.get(name)),
                tuple(_pages(catalogue.known(name), sinks[name])),
                _every_ticks(catalogue.known(name), bus, half_cycle_ms),
            )
            for name in names
        ),
        tuple(build_orders(catalogue, bus.integrity, orders)),
    )


def _find_sinks(
    catalogue: SignalCatalogue, configuration: Configuration
) -> dict[str, list[tuple[Signal, SignalSink]]]:
    """Signals and what goes into them, by message."""
    sinks: dict[str, list[tuple[Signal, SignalSink]]] = {}
    for quantity, given, _ in configuration.signals.entries():
        if quantity not in QUANTITIES:
            continue
        hit = catalogue.find(given.signal, f"signals.{quantity}")
        if hit is not None:
            sink = _sink(catalogue, quantity, hit[1], given)
            sinks.setdefault(hit[0].name, []).append((hit[1], sink))
    for name, found in sinks.items():
        found.extend(_load_current(catalogue, name))
    return sinks


def _pages(message: Message, sinks: list[tuple[Signal, SignalSink]]) -> Iterator[Page]:
    """Every page, whether or not it carries something; what several carry is in each of them."""
    for choice in choices(message, message.signals):
        own = tuple(sink for signal, sink in sinks if is_carried(message, signal, choice))
        yield Page(choice, own)


def _every_ticks(message: Message, bus: CanBus, half_cycle_ms: float) -> int:
    if message.name == bus.clock_message:
        return bus.clock_ticks
    return max(1, round(1e3 * cycle_time_s(message) / half_cycle_ms))


def _sink(
    catalogue: SignalCatalogue, quantity: str, signal: Signal, given: SignalSource
) -> SignalSink:
    scale, offset = given.scale, given.offset
    if isinstance(given, SwitchSource) and given.on is not None:
        on = catalogue.resolve(compile_field(signal), given.on, f"signals.{quantity}.on") or 0.0
        off = 0.0 if on else 1.0
        scale, offset = 1.0 / (on - off), -off / (on - off)
    layout = compile_field(signal, measured=True)
    low, high = sorted((layout.physical(layout.low), layout.physical(layout.high)))
    modulus = counter_modulus(compile_field(signal)) if quantity == "counter" else 0
    return SignalSink(quantity, signal.name, scale, offset, low, high, modulus)


def _load_current(catalogue: SignalCatalogue, message: str) -> Iterator[tuple[Signal, SignalSink]]:
    mapped = SignalSource(signal=f"{message}.{LOAD_CURRENT}")
    for signal in catalogue.known(message).signals:
        if signal.name == LOAD_CURRENT:
            yield signal, _sink(catalogue, "load_current_A", signal, mapped)
