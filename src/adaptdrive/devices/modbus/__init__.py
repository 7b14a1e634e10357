"""Modbus, TCP and RTU: ports of a drive and of sensors, and how the daemon builds them.

Each block that comes is handed out as old as its request. A value that must not be used is left
out, a module that does not answer leaves out its own: what is held then grows old at whoever holds
it. Nothing is ever written.

A missing reply keeps the link busy for a whole time-out, on a serial line for three. So a
block whose last reply is missing comes after those that answer, and waits where the cycle is used
up. Of the blocks that stay silent until their values are too old to be used, the one that was asked
least is asked for once in ten cycles, or as soon as there is time for a missing reply.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby
from pathlib import Path

from adaptdrive.config import Configuration, polled, root
from adaptdrive.config.bus import Signals
from adaptdrive.config.consistency import LATE_READINGS
from adaptdrive.devices import binding, description
from adaptdrive.devices.bus import BusKind, polled_cautions, tcp_locks
from adaptdrive.devices.description import Source
from adaptdrive.devices.modbus.frames import are_alike
from adaptdrive.devices.modbus.link import ModbusConnection, SerialPort, describe_bus, miss_s
from adaptdrive.devices.polled import Port as PolledPort
from adaptdrive.devices.polled import mapping
from adaptdrive.devices.polled.link import ExchangeError, PolledLink, Polling
from adaptdrive.devices.polled.registers import Exchange, cycle_flaws, plan_blocks
from adaptdrive.devices.port import SensorListener
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.util.errors import ConfigurationError, Flaw

# Sensors on a Modbus link: modules that are polled in a cycle of their own.

SELDOM_CYCLES = 10
"""Cycles between two requests to silent blocks that do not fit: one in ten may be late."""

_UNANSWERED = frozenset({None, 10, 11})
"""No exception reply, or the codes of a gateway for a device behind it that does not answer."""


_Blocks = Mapping[Exchange, tuple[Source[mapping.Named], ...]]
"""Requests for registers, each with the values in them."""


class Turns:
    """The requests of one open link, those with the fewest missing replies first."""

    def __init__(self, exchanges: Iterable[Exchange], patience: int) -> None:
        """Ask for every block in the first cycle.

        Args:
            exchanges: The requests in the order in which they are made while all are answered.
            patience: Replies missing in a row after which a block is silent.
        """
        self._misses = dict.fromkeys(exchanges, 0)
        self._patience = patience
        self._cycle = 0
        self._missing: set[int | None] = set()

    def due(self, left_s: Callable[[], float], miss_s: float) -> Iterator[Exchange]:
        """Yield what is asked for in a cycle; each must be noted before the next one is taken.

        Args:
            left_s: Returns the time that is left of the cycle, in s.
            miss_s: Time for which a missing reply keeps the link busy, in s.
        """
        self._cycle += 1
        self._missing.clear()
        order = sorted(self._misses, key=self._misses.__getitem__)
        for one in order:
            misses = self._misses[one]
            silent = misses >= self._patience
            doubtful = one.device_id in self._missing or (misses and self._missing)
            wanted = one is order[0] if silent else not doubtful
            needed_s = miss_s if silent and self._cycle % SELDOM_CYCLES else 0.0
            if wanted or left_s() >= needed_s:
                yield one

    def note(self, exchange: Exchange, *, answered: bool) -> None:
        """Note what became of a request; a silent device that answers is awake as a whole."""
        device, awake = exchange.device_id, self._misses[exchange] >= self._patience
        if not answered:
            self._missing.add(device)
            self._misses[exchange] += 1
            return
        same = [one for one in self._misses if one.device_id == device]
        for one in same if awake else [exchange]:
            self._misses[one] = 0


def build_modbus_sensors(
    bus: root.ModbusTcpSensors | root.ModbusRtuSensors,
    place: str,
    clock: Callable[[], float],
    source: Path | str = "configuration",
    demands: description.Demands = description.NO_DEMANDS,
) -> SensorPort:
    """Build the port of one sensor bus; nothing is opened yet.

    Args:
        bus: One entry of `[[sensor_bus]]`; its references are those of a validated configuration.
        place: Where it stands in the configuration.
        clock: Monotonic clock in seconds.
        source: The configuration, for the error message.
        demands: What the registers must be able to carry.

    Raises:
        ConfigurationError: The wanted cycle does not fit on the link.
    """
    catalogue = mapping.RegisterCatalogue(bus.registers)
    sources = catalogue.sources(binding.sensor_entries(bus, place), demands)
    blocks = dict(_blocks(bus, sources))
    flaws = [*catalogue.flaws, *cycle_flaws(bus, [*blocks], bus.cycle_s, f"{place}.cycle_s")]
    if flaws:
        raise ConfigurationError(source, flaws)
    return SensorPort(bus, blocks, clock)


class SensorPort(Polling[ModbusConnection, SensorListener]):
    """One connection to the modules on one link."""

    def __init__(
        self,
        config: root.ModbusTcpSensors | root.ModbusRtuSensors,
        blocks: _Blocks,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(describe_bus(config), config.cycle_s, clock)
        self._serial = SerialPort(config) if isinstance(config, polled.RtuLink) else None
        self._config = config
        self._blocks = blocks
        self._alike = are_alike(config, [*blocks])
        self._patience = math.ceil(config.oldest_s / config.cycle_s - 1e-6)

    async def run(self, listener: SensorListener) -> None:
        """Poll until cancelled; a link that is lost or not there is opened again.

        Args:
            listener: Receiver of values and of the state of the bus.
        """
        self._listener = listener
        await self._run(*await self._try())

    def _new_link(self) -> ModbusConnection:
        return ModbusConnection(
            self._config, self._counts, self._clock, len(self._blocks), serial=self._serial
        )

    async def _serve(self, link: ModbusConnection) -> None:
        next_s = self._clock()
        turns = Turns(self._blocks, self._patience)
        while link.lost is None and not self._closing:
            await self._poll(link, turns)
            next_s = self._next(next_s)
            await self._sleep(next_s - self._clock())

    async def _poll(self, link: ModbusConnection, turns: Turns) -> None:
        """Ask for the blocks that are due; one that does not come leaves the others wanted."""
        end_s = self._clock() + self._config.cycle_s
        answered, problem = False, ""
        self._begin_cycle()
        for asked in turns.due(lambda: end_s - self._clock() - link.unsettled_s(), link.miss_s):
            if link.lost is not None or self._closing:
                return
            try:
                words = await link.exchange(asked, [], lambda: self._closing)
            except ExchangeError as failure:
                turns.note(asked, answered=failure.code not in _UNANSWERED)
                problem = failure.problem
                continue
            turns.note(asked, answered=True)
            answered = True
            self._note_bus(up=True)
            if self._listener is not None and not self._is_mixed_up:
                self._listener.on_values(self._values(asked, words), link.asked_s)
        if self._is_mixed_up:
            link.suspect()  # the replies that are left would answer the next cycle
        if answered:
            self._silent = 0
        else:
            self._note_silence(problem)

    def _values(self, asked: Exchange, words: list[int]) -> dict[str, float]:
        """The values of a reply that may be used, by name."""
        read = asked.read
        assert read is not None  # noqa: S101 - sensors are read, never written
        sources = self._blocks[asked]
        values = {one.quantity: mapping.value_in(one, read, words) for one in sources}
        good = {name: value for name, value in values.items() if value is not None}
        self._counts["out_of_range"] += len(values) - len(good)
        return good


def _blocks(
    bus: root.ModbusTcpSensors | root.ModbusRtuSensors, sources: list[Source[mapping.Named]]
) -> Iterator[tuple[Exchange, tuple[Source[mapping.Named], ...]]]:
    """Blocks of every device on the link, one device after the other."""

    def device(source: Source[mapping.Named]) -> int:
        return bus.registers[source.item.name].device_id or bus.device_id

    for device_id, found in groupby(sorted(sources, key=device), key=device):
        taken = [*found]
        registers = (one.item.register for one in taken)
        for block in plan_blocks(registers, bus.max_gap, bus.max_block):
            yield Exchange(read=block, device_id=device_id), mapping.inside(block, taken)


# A drive on Modbus: its port, and how the daemon builds it.

_LOST_REPLIES = 2
"""Replies in a row that may be lost on a drive that runs."""


class Port(PolledPort):
    """One connection to one drive on Modbus."""

    def __init__(
        self,
        config: polled.ModbusTcp | polled.ModbusRtu,
        poll: mapping.Poll,
        timing: Timing,
        clock: Callable[[], float],
    ) -> None:
        super().__init__(describe_bus(config), config, poll, timing, clock)
        self._config = config
        self._serial = SerialPort(config) if isinstance(config, polled.RtuLink) else None
        self.must_open = self._serial is not None
        self._alike = are_alike(config, [Exchange(read=block) for block, _ in poll.reads])

    def _new_link(self) -> PolledLink:
        return ModbusConnection(self._config, self._counts, self._clock, serial=self._serial)


def _build(
    configuration: Configuration, clock: Callable[[], float], source: Path | str, passive: bool
) -> Port:
    bus = _bus(configuration)
    poll = mapping.map_drive(configuration, bus, source, passive=passive)
    return Port(bus, poll, timing_of(configuration), clock)


def _cautions(configuration: Configuration) -> Iterator[Flaw]:
    """Yield what time-outs and lost replies do not fit, and a report that may be an echo."""
    yield from polled_cautions(configuration)
    yield from _loss_cautions(_bus(configuration), timing_of(configuration))
    yield from _echo_cautions(_bus(configuration), configuration.signals)


def _loss_cautions(bus: polled.ModbusTcp | polled.ModbusRtu, timing: Timing) -> Iterator[Flaw]:
    """Yield one word on a drive that trips as soon as few replies are lost or late."""
    least_s = LATE_READINGS * timing.reading_s + _LOST_REPLIES * miss_s(bus)
    if timing.stale_s < least_s and not math.isclose(timing.stale_s, least_s):
        text = f"{timing.stale_s:g} s is shorter than {least_s:.4g} s, {LATE_READINGS:g} polls and"
        lost = f"the {_LOST_REPLIES * miss_s(bus):.4g} s of {_LOST_REPLIES} lost replies"
        yield Flaw("interlocks.stale_s", f"{text} {lost} (bus.timeout_s): they trip it")


def _echo_cautions(bus: polled.ModbusTcp | polled.ModbusRtu, signals: Signals) -> Iterator[Flaw]:
    """Yield one word on a report of the bridge in the register of its command."""
    report, command = signals.bridge, signals.command.bridge
    if report is None or command is None:
        return
    read, written = bus.registers[report.signal], bus.registers[command.signal]
    same = read.table == written.table or (read.table, written.table) == ("discrete", "coil")
    if not same or read.address != written.address:
        return
    yield Flaw(
        "signals.bridge",
        f"{report.signal!r} lies in the register of signals.command.bridge: where the drive only "
        "keeps there what was written, each stop is confirmed, of a drive that does not obey too; "
        "name a register that follows the power stage, or see with the drive in local mode that "
        "the register does not follow the command",
    )


def _lock_names(configuration: Configuration) -> Iterator[str]:
    """Yield a device over TCP, by its addresses, too; a serial line is locked as a whole."""
    bus = _bus(configuration)
    if isinstance(bus, polled.ModbusTcp):
        yield describe_bus(bus)
        yield from tcp_locks("modbus-tcp", bus.host, bus.port, f" device {bus.device_id}")


def _bus(configuration: Configuration) -> polled.ModbusTcp | polled.ModbusRtu:
    assert isinstance(configuration.bus, polled.ModbusTcp | polled.ModbusRtu)  # noqa: S101 - selected by its type
    return configuration.bus


MODBUS = BusKind(_build, _cautions, build_modbus_sensors, lock_names=_lock_names)
