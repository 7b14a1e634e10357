"""The simulated drive as a node on a CAN bus.

At the end of each half line cycle, on an absolute grid that follows the line, it sends the status
messages that are due by their cycle times, the clocking one last; the pages of a multiplexed
message take turns. It obeys command frames whose length, checksum, alive counter, ranges and
constants are right, ignores and counts the others, and leaves what is not addressed to it alone. A
command that is spread over several frames is obeyed when the one with the bridge has come.

It reads the same configuration as the daemon: what is measured there is sent here, and what is
commanded there is obeyed here.
"""

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import can
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.bus import CanBus, SignalSource, SwitchSource
from adaptdrive.config.root import Configuration
from adaptdrive.devices.can import connection, database, integrity, mapping
from adaptdrive.devices.can.assembly import CommandFrame
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.codec import MessageCodec, frame_key
from adaptdrive.devices.can.layout import compile_field, counter_modulus
from adaptdrive.devices.description import demands_of
from adaptdrive.util.errors import BusError, ConfigurationError
from adaptdrive_sim.devices.drive import QUANTITIES, DriveNode, Frame, SimulatedDrive

# Quantities of the drive in messages.

LOAD_CURRENT = "LoadCurrent"
"""Sent where the database has such a signal; no configuration needs it."""


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


Sinks = list[tuple[Signal, SignalSink]]
Page = tuple[Mapping[str, float], tuple[SignalSink, ...]]
"""Selectors of one frame of a message, and its sinks; without multiplexing there is one page."""


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

    def encode(self, number: int, quantities: Mapping[str, float]) -> bytes:
        """Make the frame of a number."""
        selectors, sinks = self.pages[number % len(self.pages)]
        values = {sink.signal: sink.value(quantities) for sink in sinks}
        return self.codec.encode({**selectors, **values})


def load_messages(
    bus: CanBus, configuration: Configuration, source: Path
) -> tuple[list[StatusMessage], tuple[CommandFrame, ...]]:
    """Find the drive's messages in the configured database.

    Args:
        bus: The configuration's bus.
        configuration: The drive's configuration.
        source: Its file, for the error message.

    Returns:
        Messages in the order of sending, the clocking one last, and the frames that are obeyed.

    Raises:
        ConfigurationError: The database and the configuration do not fit together.
    """
    catalogue = database.open_catalogue(bus, source)
    sinks = _find_sinks(catalogue, configuration)
    sent = catalogue.sinks(configuration.signals.command, demands_of(configuration))
    found = mapping.find_orders(catalogue, sent)
    if catalogue.flaws:
        raise ConfigurationError(source, catalogue.flaws)
    half_cycle_ms = 500.0 / configuration.drive.line_frequency_Hz
    names = sorted(sinks, key=lambda name: (name == bus.clock_message, name))
    status = [_status(catalogue.known(one), sinks[one], bus, half_cycle_ms) for one in names]
    return status, tuple(mapping.build_orders(catalogue, bus.integrity, found))


def _find_sinks(catalogue: database.SignalCatalogue, whole: Configuration) -> dict[str, Sinks]:
    """Signals and what goes into them, by message."""
    sinks: dict[str, Sinks] = {}
    for quantity, given, _ in whole.signals.entries():
        if quantity not in QUANTITIES:
            continue
        hit = catalogue.find(given.signal, f"signals.{quantity}")
        if hit is not None:
            sink = _sink(catalogue, quantity, hit[1], given)
            sinks.setdefault(hit[0].name, []).append((hit[1], sink))
    for name, found in sinks.items():
        mapped = SignalSource(signal=f"{name}.{LOAD_CURRENT}")
        for signal in catalogue.known(name).signals:
            if signal.name == LOAD_CURRENT:
                found.append((signal, _sink(catalogue, "load_current_A", signal, mapped)))
    return sinks


def _status(message: Message, sinks: Sinks, bus: CanBus, half_cycle_ms: float) -> StatusMessage:
    """Return a message with every page, whether or not it carries something.

    What several pages carry is in each of them.
    """
    pages = tuple(
        (choice, tuple(one for s, one in sinks if mapping.is_carried(message, s, choice)))
        for choice in mapping.choices(message, message.signals)
    )
    every_ticks = bus.clock_ticks
    if message.name != bus.clock_message:
        every_ticks = max(1, round(1e3 * database.cycle_time_s(message) / half_cycle_ms))
    return StatusMessage(MessageCodec(message, bus.integrity.get(message.name)), pages, every_ticks)


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


# The drive on its bus.

_REOPEN_S = 0.1
"""Interval at which a drive that has lost its bus tries to open it."""


class CanDrive(DriveNode):
    """One simulated drive on one bus."""

    def __init__(self, drive: SimulatedDrive, configuration: Configuration, source: Path) -> None:
        """Build the node; nothing is opened yet.

        Raises:
            ConfigurationError: Database and configuration do not fit together.
        """
        super().__init__(drive)
        assert isinstance(configuration.bus, CanBus)  # noqa: S101 - `KINDS` has looked
        self._config = configuration.bus
        self._status, self._orders = load_messages(self._config, configuration, source)
        self._codecs = {order.codec.key: order.codec for order in self._orders}
        self._wanted: dict[str, float] = {}
        self._numbers: dict[str, int] = {}
        self._bus: can.BusABC | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and serve it until cancelled.

        The drive outlives a bus that is lost, as a real one does, and opens it again.

        Raises:
            BusError: The bus cannot be opened at the first attempt.
        """
        self._bus = open_bus(self._config)
        try:
            opened(describe_bus(self._config))
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._receive(self._bus))
                tasks.create_task(self._run_half_cycles(self._send))
        finally:
            self._leave_bus()

    def take(self, frame: can.Message) -> None:
        """Obey a command frame that is whole and alive."""
        key = frame_key(frame.arbitration_id, extended=frame.is_extended_id)
        codec = self._codecs.get(key)
        if codec is None:
            return
        verdict, values, _ = codec.decode(bytes(frame.data))
        if verdict is not integrity.FrameVerdict.GOOD:
            self._refuse(verdict.value)
            return
        self._take_values(codec, values)

    def _take_values(self, codec: MessageCodec, values: Mapping[str, float]) -> None:
        known = [order for order in self._orders if order.codec is codec]
        order = next((one for one in known if one.fixed.items() <= values.items()), None)
        if order is None:
            self._refuse("wrong_constant")
            return
        parts = order.parts.items()
        received = {one.name: (values[signal] - one.base) / one.factor for signal, one in parts}
        self._wanted |= received
        if "bridge" in received:
            self._obey(self._wanted)

    def take_garbage(self) -> None:
        """Count what is no frame."""
        self._refuse("garbage")

    async def _receive(self, bus: can.BusABC) -> None:
        while True:
            self._report("bus lost", problem=await connection.FrameReader(bus, self).run())
            self._leave_bus()
            bus = self._bus = await self._reopened()
            self._report("bus back")

    async def _reopened(self) -> can.BusABC:
        while True:
            await asyncio.sleep(_REOPEN_S)
            with contextlib.suppress(BusError):
                return open_bus(self._config)

    def _leave_bus(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def _send(self, frame: Frame) -> None:
        quantities, tick = frame.quantities(), frame.sample.tick
        for message in self._status:
            codec, number = message.codec, tick // message.every_ticks
            if number == self._numbers.get(codec.name):
                continue
            self._numbers[codec.name] = number
            data, fast = message.encode(number, quantities), self._config.bitrate_switch
            out = codec.frame(data, bitrate_switch=fast)
            self.counts["sent" if send(self._bus, out) else "dropped"] += 1


def send(bus: can.BusABC | None, frame: can.Message) -> bool:
    """Send a frame; return whether there is a bus that has taken it."""
    try:
        if bus is not None:
            bus.send(frame)
    except (can.CanError, OSError):
        return False
    return bus is not None
