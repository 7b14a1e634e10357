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

from adaptdrive.config.bus import CanBus
from adaptdrive.config.root import Configuration
from adaptdrive.devices import description
from adaptdrive.devices.can import connection, database, integrity, kind, mapping
from adaptdrive.devices.can.assembly import CommandFrame, StatusFrame
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.codec import MessageCodec, frame_key
from adaptdrive.devices.can.layout import compile_field, counter_modulus
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices.drive import QUANTITIES, DriveNode, Frame, SimulatedDrive

# Quantities of the drive in messages.

LOAD_CURRENT = "LoadCurrent"
"""Sent where the database has such a signal; no configuration needs it."""


_Source = description.Source[database.Located]

Page = tuple[Mapping[str, float], tuple[_Source, ...]]
"""Selectors of a frame of a message, and what it shows; without multiplexing there is one page."""


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
        selectors, sources = self.pages[number % len(self.pages)]
        values = {one.field.name: _shown(one, quantities[one.quantity]) for one in sources}
        return self.codec.encode({**selectors, **values})


def _shown(source: _Source, quantity: float) -> float:
    """The signal's value of a quantity; like a converter's, it ends at the signal's range."""
    if source.quantity == "counter":
        return quantity % counter_modulus(source.field)
    if source.on is not None:
        return source.on if quantity else float(not source.on)
    low, high = source.field.ends
    return min(max((quantity - source.offset) / source.scale, low), high)


def load_messages(
    bus: CanBus, configuration: Configuration, source: Path
) -> tuple[list[StatusMessage], tuple[CommandFrame, ...]]:
    """Find the drive's messages in the configured database, as the daemon does.

    Args:
        bus: The configuration's bus.
        configuration: The drive's configuration.
        source: Its file, for the error message.

    Returns:
        Messages in the order of sending, the clocking one last, and the frames that are obeyed.

    Raises:
        ConfigurationError: The database and the configuration do not fit together.
    """
    mapped = kind.mapped(configuration, source)
    half_cycle_ms = 1e3 * timing_of(configuration).half_cycle_s
    found = [_status(one, bus, half_cycle_ms) for one in mapped.statuses]
    sent = [one for one in found if any(shown for _, shown in one.pages)]
    sent.sort(key=lambda one: (one.codec.name == bus.clock_message, one.codec.name))
    return sent, mapped.orders


def _status(status: StatusFrame, bus: CanBus, half_cycle_ms: float) -> StatusMessage:
    """Return a message with every page, whether or not it carries something.

    What several pages carry is in each of them.
    """
    message = status.sources[0].item.message
    sources = [one for one in status.sources if one.quantity in QUANTITIES]
    for signal in message.signals:
        if sources and signal.name == LOAD_CURRENT:
            located, field = database.Located(message, signal), compile_field(signal, measured=True)
            sources.append(description.Source("load_current_A", located, field, 1.0, 0.0, None, ""))
    pages = tuple(
        (choice, tuple(s for s in sources if mapping.is_carried(message, s.item.signal, choice)))
        for choice in mapping.choices(message, message.signals)
    )
    every_ticks = bus.clock_ticks
    if message.name != bus.clock_message:
        every_ticks = max(1, round(1e3 * database.cycle_time_s(message) / half_cycle_ms))
    return StatusMessage(MessageCodec(message, bus.integrity.get(message.name)), pages, every_ticks)


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
            out = codec.frame(message.encode(number, quantities))
            self.counts["sent" if send(self._bus, out) else "dropped"] += 1


def send(bus: can.BusABC | None, frame: can.Message) -> bool:
    """Send a frame; return whether there is a bus that has taken it."""
    try:
        if bus is not None:
            bus.send(frame)
    except (can.CanError, OSError):
        return False
    return bus is not None
