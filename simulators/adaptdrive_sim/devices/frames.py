"""Which quantity of the simulated drive travels in which signal of which message.

The drive reads the same configuration as the daemon, from the other side: what is measured there
is sent here, and what is commanded there is obeyed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can.database import Database
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, SignalSource
from adaptdrive.config.root import Configuration
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.can.codec import MessageCodec
from adaptdrive.hardware.can.database import Catalogue, load_database, message_codec
from adaptdrive_sim.devices.drive import Frame

LOAD_CURRENT = "LoadCurrent"
"""Sent where the database has such a signal; no configuration needs it."""

_QUANTITIES = (
    "boost_voltage_V",
    "line_voltage_V",
    "load_power_W",
    "output",
    "counter",
    "fault",
    "bridge",
)


@dataclass(frozen=True, slots=True)
class Sink:
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
class StatusMessage:
    """One message that the drive sends each half cycle."""

    codec: MessageCodec
    sinks: tuple[Sink, ...]

    def encode(self, quantities: Mapping[str, float]) -> bytes:
        """Make the next frame."""
        return self.codec.encode({sink.signal: sink.value(quantities) for sink in self.sinks})


@dataclass(frozen=True, slots=True)
class CommandMessage:
    """The message that the drive obeys.

    Attributes:
        codec: The message.
        value: Signal of the line-current scale, or of V_c for a drive that holds its own voltage.
        bridge: Signal of the bridge.
    """

    codec: MessageCodec
    value: str
    bridge: str


@dataclass(frozen=True, slots=True)
class DriveMessages:
    """All that the drive says and hears.

    Attributes:
        status: Messages in the order of sending, the clocking one last.
        command: The message that it obeys.
    """

    status: tuple[StatusMessage, ...]
    command: CommandMessage


def quantities_of(frame: Frame) -> dict[str, float]:
    """A frame's quantities by name."""
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
    database = load_database(bus.database, source)
    return DriveMessages(
        _status_messages(database, bus, configuration, source),
        _command_message(database, bus, configuration, source),
    )


def _status_messages(
    database: Database, bus: CanBus, configuration: Configuration, source: Path
) -> tuple[StatusMessage, ...]:
    sinks: dict[str, list[Sink]] = {bus.clock: []}
    catalogue = Catalogue(database)
    for quantity in _QUANTITIES:
        given = getattr(configuration.signals, quantity)
        if given is None:
            continue
        mapped = SignalSource(signal=given) if isinstance(given, str) else given
        found = catalogue.signal(mapped.signal, f"signals.{quantity}")
        if found is not None:
            sinks.setdefault(found[0].name, []).append(_sink(quantity, found[1], mapped))
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    names = sorted(sinks, key=lambda name: (name == bus.clock, name))
    return tuple(
        StatusMessage(
            message_codec(database, bus, name, source),
            (*sinks[name], *_load_current(database, name)),
        )
        for name in names
    )


def _sink(quantity: str, signal: Signal, mapped: SignalSource) -> Sink:
    low, high = signal.minimum, signal.maximum
    return Sink(
        quantity,
        signal.name,
        mapped.scale,
        mapped.offset,
        float("-inf") if low is None else float(low),
        float("inf") if high is None else float(high),
        1 << signal.length if quantity == "counter" else 0,
    )


def _load_current(database: Database, message: str) -> list[Sink]:
    signals = database.get_message_by_name(message).signals
    mapped = SignalSource(signal=f"{message}.{LOAD_CURRENT}")
    return [_sink("load_current_A", one, mapped) for one in signals if one.name == LOAD_CURRENT]


def _command_message(
    database: Database, bus: CanBus, configuration: Configuration, source: Path
) -> CommandMessage:
    command = configuration.signals.command
    holds_voltage = configuration.voltage_loop.where == "drive"
    given = command.boost_reference_V if holds_voltage else command.current_scale_S
    message, _, value = (given or "").partition(".")
    bridge_message, _, bridge = (command.bridge or "").partition(".")
    if message != bridge_message:
        problem = f"{command.bridge!r} is not in the message of {given!r}"
        raise ConfigurationError(source, [Flaw("signals.command.bridge", problem)])
    return CommandMessage(message_codec(database, bus, message, source), value, bridge)
