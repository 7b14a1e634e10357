"""Quantities of the simulated drive in signals, messages and registers.

The drive reads the same configuration as the daemon, from the other side: what is measured there
is sent here, and what is commanded there is obeyed here.

The drive reads the same configuration as the daemon. A table has every address from its first
register to its last; what lies between and is not mapped reads as 0.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config import polled, root
from adaptdrive.config.bus import COMMANDED, MEASURED, CanBus, Signals, SignalSource, SwitchSource
from adaptdrive.control.signals import Command
from adaptdrive.devices.can import database
from adaptdrive.devices.can.assembly import CommandFrame
from adaptdrive.devices.can.codec import MessageCodec
from adaptdrive.devices.can.layout import compile_field, counter_modulus
from adaptdrive.devices.can.mapping import build_orders, choices, find_orders, is_carried
from adaptdrive.devices.description import demands_of
from adaptdrive.devices.field import Field, Raw
from adaptdrive.devices.polled.registers import (
    decode_value,
    encode_count,
    encode_value,
    register_field,
)
from adaptdrive.util.errors import ConfigurationError
from adaptdrive_sim.devices.drive import Frame

# Mapping of the simulated drive's quantities to signals and messages.

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


def load_messages(bus: CanBus, configuration: root.Configuration, source: Path) -> DriveMessages:
    """Find the drive's messages in the configured database.

    Args:
        bus: The configuration's bus.
        configuration: The drive's configuration.
        source: Its file, for the error message.

    Raises:
        ConfigurationError: The database and the configuration do not fit together.
    """
    catalogue = database.open_catalogue(bus, source)
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
    catalogue: database.SignalCatalogue, configuration: root.Configuration
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
    return max(1, round(1e3 * database.cycle_time_s(message) / half_cycle_ms))


def _sink(
    catalogue: database.SignalCatalogue, quantity: str, signal: Signal, given: SignalSource
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


def _load_current(
    catalogue: database.SignalCatalogue, message: str
) -> Iterator[tuple[Signal, SignalSink]]:
    mapped = SignalSource(signal=f"{message}.{LOAD_CURRENT}")
    for signal in catalogue.known(message).signals:
        if signal.name == LOAD_CURRENT:
            yield signal, _sink(catalogue, "load_current_A", signal, mapped)


# The register map from the drive's side: what is measured there is written here.

Table = dict[int, int]


class RegisterImage:
    """The registers of one drive.

    Attributes:
        tables: Content by address, for input and holding registers.
    """

    def __init__(self, bus: polled.ModbusBus, signals: Signals) -> None:
        self._bus = bus
        self._signals = signals
        self.tables: dict[str, Table] = {
            table: addresses(bus.registers.values(), table) for table in ("input", "holding")
        }

    def show(self, quantities: Mapping[str, float]) -> None:
        """Put a half cycle's quantities into the registers."""
        words: dict[tuple[str, int], int] = {}
        for name, source in self._shown():
            register = self._bus.registers[source.signal]
            value = (quantities[name] - source.offset) / source.scale
            if name in MEASURED:
                _place(words, register, encode_value(register, bounded(register, value)))
            else:
                _place(words, register, encode_count(register, _wrapped(register, int(value))))
        for (table, address), word in words.items():
            self.tables[table][address] = word

    def command(self, tables: Mapping[str, Table]) -> Command | None:
        """Return the command of the daemon; None when a register has an invalid value."""
        found: dict[str, float] = {"current_scale_S": 0.0, "boost_reference_V": 0.0}
        for name in COMMANDED:
            given = getattr(self._signals.command, name)
            if given is None:
                continue
            register = self._bus.registers[given.signal]
            words = [tables[register.table][a] for a in range(register.address, register.end)]
            value = decode_value(register, words, measured=False)
            if value is None:
                return None
            if isinstance(given, SignalSource):
                found[name] = value * given.scale + given.offset
            else:
                found[name] = value == _switching(given.on, register.on, register)
        return Command(**found)  # type: ignore[arg-type]

    def heartbeat(self, tables: Mapping[str, Table]) -> tuple[int, ...] | None:
        """The daemon's heartbeat as it stands, None where the map has none."""
        name = self._bus.heartbeat.daemon
        if name is None:
            return None
        register = self._bus.registers[name]
        return tuple(tables[register.table][a] for a in range(register.address, register.end))

    def _shown(self) -> Iterator[tuple[str, SignalSource]]:
        for name, source, _ in self._signals.entries():
            if name in QUANTITIES:
                yield name, source
        if self._bus.heartbeat.drive is not None:
            yield "counter", SignalSource(signal=self._bus.heartbeat.drive)


def addresses(registers: Iterable[polled.Register], table: str) -> Table:
    """Return a table from the first register to the last, filled with 0."""
    spans = [(one.address, one.end) for one in registers if one.table == table]
    if not spans:
        return {}
    return dict.fromkeys(range(min(a for a, _ in spans), max(b for _, b in spans)), 0)


def not_available(register: polled.Register) -> float:
    """The count that means `no value`."""
    if register.not_available is not None:
        return register.not_available
    if register.real:
        return math.nan
    span = 1 << 16 * register.words
    return -span // 2 if register.type.startswith("int") else span - 1


def _place(
    words: dict[tuple[str, int], int], register: polled.Register, content: Sequence[int]
) -> None:
    """Put registers down; bits that share a register are joined."""
    for number, word in enumerate(content, register.address):
        beside = 0 if register.bits is None else words.get((register.table, number), 0)
        words[register.table, number] = word | beside


def _switching(given: int | str | None, usual: int, register: polled.Register) -> int:
    """Return the count of a switch, which a configuration may name."""
    if given is None:
        return usual
    return register.names[given] if isinstance(given, str) else given


def bounded(register: polled.Register, value: float) -> float:
    """Like a converter's, a value ends at the range of its register."""
    field = register_field("", register, "measured")
    low, high = sorted(field.physical(end) for end in _without(field))
    if register.range is not None:
        low, high = max(low, register.range.low), min(high, register.range.high)
    return min(max(value, low), high)


def _without(field: Field) -> tuple[Raw, Raw]:
    """Return the lowest and the highest count, without the one for no value."""
    low, high = field.low, field.high
    return low + (low in field.unknown), high - (high in field.unknown)


def _wrapped(register: polled.Register, count: int) -> int:
    return count % (1 << (16 * register.words - register.type.startswith("int")))
